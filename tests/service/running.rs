//! A service in the test's own process.

use std::path::Path;

use mapshift::api::{AccessOptions, Limits};
use mapshift::app::{self, RunningApp};
use mapshift::config::AppConfig;
use mapshift::pipeline::PipelineOptions;
use mapshift::webhooks::DeliveryOptions;
use tempfile::TempDir;

use crate::client::Client;

/// A running service with a client of it.
pub struct Running {
    pub client: Client,
    app: RunningApp,
    _directory: Option<TempDir>,
}

impl Running {
    /// In a directory of its own that goes with it.
    pub async fn start() -> Self {
        let directory = TempDir::new().unwrap();
        let mut running = Self::start_in(directory.path()).await;
        running._directory = Some(directory);
        running
    }

    pub async fn start_in(directory: &Path) -> Self {
        Self::start_delivering(directory, DeliveryOptions::default()).await
    }

    pub async fn start_delivering(directory: &Path, delivery: DeliveryOptions) -> Self {
        let config = AppConfig {
            delivery,
            ..config_in(directory)
        };
        Self::start_with(config, Client::new).await
    }

    /// With a client that is made from the service's URL.
    pub async fn start_with(config: AppConfig, client: impl FnOnce(&str) -> Client) -> Self {
        let app = app::start(config).await.unwrap();
        Self {
            client: client(&format!("http://{}", app.local_addr())),
            app,
            _directory: None,
        }
    }

    pub async fn stop(self) {
        self.app.shutdown().await.unwrap();
    }
}

/// What a service starts with whose data directory is within another.
pub fn config_in(directory: &Path) -> AppConfig {
    AppConfig {
        listen: "127.0.0.1:0".parse().unwrap(),
        data_dir: directory.join("data"),
        accept_lost_log: false,
        limits: Limits::default(),
        pipeline: PipelineOptions::default(),
        delivery: DeliveryOptions::default(),
        access: AccessOptions::default(),
        insecure_open_to_network: false,
    }
}
