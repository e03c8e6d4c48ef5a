//! The service's settings: flags, or the variables `MAPSHIFT_*`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::ValueEnum;

use crate::api::Limits;

/// Settings of `serve`. Each can be a flag or a variable; the flag wins.
#[derive(Debug, Clone, clap::Args)]
pub struct ServiceArgs {
    /// Address to listen on; port 0 takes any free port.
    #[arg(long, env = "MAPSHIFT_LISTEN", default_value = "127.0.0.1:8080")]
    pub listen: SocketAddr,
    /// Directory that holds the database; made if it is missing.
    #[arg(long, env = "MAPSHIFT_DATA_DIR", default_value = "./data")]
    pub data: PathBuf,
    /// Form of the log on standard error.
    #[arg(long, env = "MAPSHIFT_LOG_FORMAT", default_value = "text")]
    pub log_format: LogFormat,
    /// What is logged, e.g. `info` or `mapshift=debug`.
    #[arg(long, env = "MAPSHIFT_LOG", default_value = "info")]
    pub log: String,
    /// Listen on an address that others can reach, although the service asks nobody for a key.
    #[arg(long, env = "MAPSHIFT_INSECURE_OPEN_TO_NETWORK")]
    pub insecure_open_to_network: bool,
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
    /// How much is taken on.
    pub limits: Limits,
}

/// Why settings are refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// Anyone in the network could upload, read and delete.
    #[error(
        "{0} can be reached from the network, and this version asks nobody for a key: anyone there could upload, read and delete. Listen on 127.0.0.1 behind a proxy that checks who calls, or say --insecure-open-to-network"
    )]
    OpenToNetwork(SocketAddr),
}

impl ServiceArgs {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn app_config(&self) -> Result<AppConfig, ConfigError> {
        if !self.listen.ip().is_loopback() && !self.insecure_open_to_network {
            return Err(ConfigError::OpenToNetwork(self.listen));
        }
        Ok(AppConfig {
            listen: self.listen,
            data_dir: self.data.clone(),
            limits: Limits::default(),
        })
    }
}

/// A directory of its own for a service that is thrown away afterwards; not made yet.
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
            log_format: LogFormat::Text,
            log: "info".into(),
            insecure_open_to_network,
        }
    }

    #[test]
    fn only_loopback_is_open_without_saying_so() {
        for listen in ["127.0.0.1:0", "127.8.8.8:80", "[::1]:8080"] {
            assert!(args(listen, false).app_config().is_ok(), "{listen}");
        }
        for listen in [
            "0.0.0.0:8080",
            "[::]:8080",
            "192.168.1.4:80",
            "[::ffff:127.0.0.1]:80",
        ] {
            let error = args(listen, false).app_config().unwrap_err();
            assert!(error.to_string().contains("--insecure-open-to-network"));
            assert!(args(listen, true).app_config().is_ok());
        }
    }
}
