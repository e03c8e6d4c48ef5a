//! The key that a command shows to the service.

/// The key that a command shows to the service.
#[derive(Debug, clap::Args)]
pub(super) struct KeyArg {
    /// A key of the service, if it has any. The variable is safer: other users of the machine can read
    /// arguments.
    #[arg(long, global = true, env = "MAPSHIFT_KEY", hide_env_values = true)]
    pub(super) key: Option<String>,
}
