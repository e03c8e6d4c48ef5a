//! The service's settings: flags, the variables `MAPSHIFT_*`, or a file.
//!
//! Must not know how settings are used. Begin with [`ServiceArgs::app_config`].

mod settings;
mod settings_file;

pub use settings::{Setting, settings};
pub use settings_file::{SettingsFile, SettingsFileError, settings_file_of, with_settings_file};

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::ValueEnum;

use crate::api::{AccessOptions, GroupRole, Limits, Network, PublicUrl, TrustedProxies};
use crate::pipeline::PipelineOptions;
use crate::webhooks::{DeliveryOptions, ReceiverPolicy};

/// Settings of `serve`. Each that has a variable can be given by its flag, by the variable or in a
/// file; the flag overrides the variable, and both the file.
#[derive(Debug, Clone, clap::Args)]
pub struct ServiceArgs {
    /// Address to listen on; port 0 takes any free port.
    #[arg(long, env = "MAPSHIFT_LISTEN", default_value = "127.0.0.1:8080")]
    pub listen: SocketAddr,
    /// Directory of the database; created if missing.
    #[arg(long, env = "MAPSHIFT_DATA_DIR", default_value = "./data")]
    pub data: PathBuf,
    /// Start even if a killed process's write-ahead log is lost, without its last commits.
    #[arg(long)]
    pub accept_lost_log: bool,
    /// Memory for maps that are not being worked on, MiB; the least recently used make room.
    #[arg(long, env = "MAPSHIFT_MAP_MEMORY_MB", default_value_t = 1024)]
    pub map_memory_mb: usize,
    /// Delete uploaded bodies this many days after they were merged; by default never.
    #[arg(long, env = "MAPSHIFT_KEEP_BODIES_DAYS", value_parser = clap::value_parser!(u32).range(1..=36_500))]
    pub keep_bodies_days: Option<u32>,
    /// Delete where vehicles were between keyframes, and the uploaded bodies that show it, this many days after
    /// they were merged; by default never. What is still in a map stays.
    #[arg(long, env = "MAPSHIFT_TRAJECTORY_RETENTION_DAYS", value_parser = clap::value_parser!(u32).range(1..=36_500))]
    pub trajectory_retention_days: Option<u32>,
    /// Replace the names and addresses of people this many days after they were written; by default never.
    #[arg(long, env = "MAPSHIFT_NAME_RETENTION_DAYS", value_parser = clap::value_parser!(u32).range(1..=36_500))]
    pub name_retention_days: Option<u32>,
    /// Share of connections, uploads, reads and streams that one client address may hold, per cent.
    /// The address is that of the socket, whatever X-Forwarded-For says: behind a proxy, or where all
    /// gateways come through one NAT, say 100 and have the proxy limit its clients.
    #[arg(long, env = "MAPSHIFT_ADDRESS_SHARE", default_value_t = 50, value_name = "PERCENT", value_parser = clap::value_parser!(u8).range(1..=100))]
    pub address_share: u8,
    /// Form of the log on standard error.
    #[arg(long, env = "MAPSHIFT_LOG_FORMAT", default_value = "text")]
    pub log_format: LogFormat,
    /// What is logged, e.g. `info` or `mapshift=debug`.
    #[arg(long, env = "MAPSHIFT_LOG", default_value = "info")]
    pub log: String,
    /// Listen on an address that others can reach, although there is no key and no authentication.
    #[arg(long, env = "MAPSHIFT_INSECURE_OPEN_TO_NETWORK")]
    pub insecure_open_to_network: bool,
    /// Public URL of the service, like `https://maps.example.com`, if it differs from the listening address.
    /// Requests for other names are refused.
    #[arg(long, env = "MAPSHIFT_PUBLIC_URL", value_name = "URL")]
    pub public_url: Option<PublicUrl>,
    /// Addresses of proxies whose X-Forwarded-User or X-Auth-Request-User and groups are trusted to identify
    /// the sender of a request, like 127.0.0.1 or 10.1.0.0/16; may be given several times.
    #[arg(
        long = "trusted-proxy",
        env = "MAPSHIFT_TRUSTED_PROXY",
        value_name = "CIDR",
        value_delimiter = ','
    )]
    pub trusted_proxies: Vec<Network>,
    /// Role of the members of a group that a trusted proxy has authenticated, like map-keepers=maintainer; may be
    /// given several times.
    #[arg(
        long = "proxy-role",
        env = "MAPSHIFT_PROXY_ROLE",
        value_name = "GROUP=ROLE",
        value_delimiter = ','
    )]
    pub proxy_roles: Vec<GroupRole>,
    /// Send webhooks to private networks too, and by http: for closed plants with receivers in their own
    /// network. Anyone who may register webhooks can then make the service call any address it reaches there.
    #[arg(long, env = "MAPSHIFT_WEBHOOKS_TO_PRIVATE_NETWORKS")]
    pub webhooks_to_private_networks: bool,
}

/// Form of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object a line.
    Json,
}

/// What the service needs to start.
#[derive(Debug, Clone)]
pub struct AppConfig {
    /// Address to listen on; port 0 takes any free port.
    pub listen: SocketAddr,
    /// Directory that holds the database.
    pub data_dir: PathBuf,
    /// Whether a database is opened whose write-ahead log is lost.
    pub accept_lost_log: bool,
    /// Limits on connections, uploads and reads.
    pub limits: Limits,
    /// How much is kept in memory and on disk.
    pub pipeline: PipelineOptions,
    /// How webhooks are called.
    pub delivery: DeliveryOptions,
    /// The service's public names and trusted proxies.
    pub access: AccessOptions,
    /// Whether it listens on any address even without a key.
    pub insecure_open_to_network: bool,
}

impl AppConfig {
    /// Whether the service may listen on the address: if others can reach it, only with authentication.
    ///
    /// # Errors
    /// [`ConfigError::OpenToNetwork`].
    pub fn check_reach(&self, has_keys: bool) -> Result<(), ConfigError> {
        let asks = has_keys || !self.access.proxies.networks.is_empty();
        match self.listen.ip().is_loopback() || asks || self.insecure_open_to_network {
            true => Ok(()),
            false => Err(ConfigError::OpenToNetwork(self.listen)),
        }
    }
}

/// Why settings are refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// Anyone in the network could upload, read and delete.
    #[error(
        "{0} can be reached from the network, and there is no key: anyone there could upload, read and delete. Make a key first (mapshift keys create --name … --role admin), or say --insecure-open-to-network"
    )]
    OpenToNetwork(SocketAddr),
}

impl ServiceArgs {
    /// What the service needs to start.
    pub fn app_config(&self) -> AppConfig {
        AppConfig {
            listen: self.listen,
            data_dir: self.data.clone(),
            accept_lost_log: self.accept_lost_log,
            limits: Limits {
                address_share_percent: self.address_share,
                ..Limits::default()
            },
            pipeline: self.pipeline_options(),
            delivery: self.delivery_options(),
            access: self.access_options(),
            insecure_open_to_network: self.insecure_open_to_network,
        }
    }
}

impl ServiceArgs {
    fn pipeline_options(&self) -> PipelineOptions {
        let days = |days: u32| Duration::from_secs(u64::from(days) * 24 * 60 * 60);
        PipelineOptions {
            map_memory_bytes: self.map_memory_mb.saturating_mul(1 << 20),
            // A body says where its vehicle was, too.
            keep_bodies: [self.keep_bodies_days, self.trajectory_retention_days]
                .into_iter()
                .flatten()
                .min()
                .map(days),
            keep_trajectories: self.trajectory_retention_days.map(days),
            keep_names: self.name_retention_days.map(days),
            ..PipelineOptions::default()
        }
    }
}

impl ServiceArgs {
    fn access_options(&self) -> AccessOptions {
        AccessOptions {
            public_url: self.public_url.clone(),
            proxies: TrustedProxies {
                networks: self.trusted_proxies.clone(),
                roles: self.proxy_roles.clone(),
            },
        }
    }
}

impl ServiceArgs {
    fn delivery_options(&self) -> DeliveryOptions {
        DeliveryOptions {
            policy: match self.webhooks_to_private_networks {
                false => ReceiverPolicy::Public,
                true => ReceiverPolicy::PrivateToo,
            },
            ..DeliveryOptions::default()
        }
    }
}

/// The path of a temporary data directory, which is not created yet.
pub fn temporary_data_dir() -> PathBuf {
    std::env::temp_dir().join(format!("mapshift-{}", uuid::Uuid::now_v7()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(listen: &str, insecure_open_to_network: bool) -> ServiceArgs {
        ServiceArgs {
            listen: listen.parse().unwrap(),
            data: "data".into(),
            accept_lost_log: false,
            map_memory_mb: 64,
            keep_bodies_days: Some(2),
            trajectory_retention_days: None,
            name_retention_days: Some(3),
            address_share: 25,
            log_format: LogFormat::Text,
            log: "info".into(),
            insecure_open_to_network,
            public_url: None,
            trusted_proxies: Vec::new(),
            proxy_roles: Vec::new(),
            webhooks_to_private_networks: false,
        }
    }

    #[test]
    fn private_networks_are_a_choice() {
        let mut args = args("127.0.0.1:0", false);
        let policy = |args: &ServiceArgs| args.app_config().delivery.policy;
        assert_eq!(policy(&args), ReceiverPolicy::Public);
        args.webhooks_to_private_networks = true;
        assert_eq!(policy(&args), ReceiverPolicy::PrivateToo);
    }

    #[test]
    fn the_share_of_an_address_is_a_setting() {
        let limits = args("127.0.0.1:0", false).app_config().limits;
        assert_eq!(limits.share(limits.connections), 256);
    }

    #[test]
    fn only_loopback_is_open_without_saying_so() {
        for listen in ["127.0.0.1:0", "127.8.8.8:80", "[::1]:8080"] {
            let config = args(listen, false).app_config();
            assert!(config.check_reach(false).is_ok(), "{listen}");
        }
        for listen in [
            "0.0.0.0:8080",
            "[::]:8080",
            "192.168.1.4:80",
            "[::ffff:127.0.0.1]:80",
        ] {
            let mut args = args(listen, false);
            let error = args.app_config().check_reach(false).unwrap_err();
            assert!(error.to_string().contains("--insecure-open-to-network"));
            assert!(args.app_config().check_reach(true).is_ok());
            args.trusted_proxies = vec!["10.0.0.0/8".parse().unwrap()];
            assert!(args.app_config().check_reach(false).is_ok());
            args.trusted_proxies.clear();
            args.insecure_open_to_network = true;
            assert!(args.app_config().check_reach(false).is_ok());
        }
    }

    #[test]
    fn bodies_are_kept_no_longer_than_trajectories() {
        let mut args = args("127.0.0.1:0", false);
        let kept_days = |args: &ServiceArgs| {
            let kept = args.app_config().pipeline;
            [kept.keep_bodies, kept.keep_trajectories].map(|kept| Some(kept?.as_secs() / 86_400))
        };
        assert_eq!(kept_days(&args), [Some(2), None]);
        args.trajectory_retention_days = Some(1);
        assert_eq!(kept_days(&args), [Some(1), Some(1)]);
        args.trajectory_retention_days = Some(30);
        assert_eq!(kept_days(&args), [Some(2), Some(30)]);
        args.keep_bodies_days = None;
        assert_eq!(kept_days(&args), [Some(30), Some(30)]);
    }

    #[test]
    fn memory_is_given_in_mebibytes_and_time_in_days() {
        let kept = args("127.0.0.1:0", false).app_config().pipeline;
        assert_eq!(kept.map_memory_bytes, 64 * 1024 * 1024);
        assert_eq!(kept.keep_bodies, Some(Duration::from_secs(172_800)));
        assert_eq!(kept.keep_names, Some(Duration::from_secs(259_200)));
        let defaults = PipelineOptions::default();
        assert_eq!(kept.active_segments, defaults.active_segments);
        assert_eq!((defaults.keep_bodies, defaults.keep_names), (None, None));
    }
}
