//! The API key that a command sends to the service.

/// The API key that a command sends to the service.
#[derive(Debug, clap::Args)]
pub(super) struct KeyArg {
    /// The API key, if the service requires one. The variable is safer: other users of the machine can read
    /// arguments.
    #[arg(long, global = true, env = "MAPSHIFT_KEY", hide_env_values = true)]
    pub(super) key: Option<String>,
}
