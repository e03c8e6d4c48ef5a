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
            listen: "127.0.0.1:0".parse().unwrap(),
            data_dir: directory.join("data"),
            accept_lost_log: false,
            limits: Limits::default(),
            pipeline: PipelineOptions::default(),
            delivery,
            access: AccessOptions::default(),
            insecure_open_to_network: false,
        };
        let app = app::start(config).await.unwrap();
        Self {
            client: Client::new(&format!("http://{}", app.local_addr())),
            app,
            _directory: None,
        }
    }

    pub async fn stop(self) {
        self.app.shutdown().await.unwrap();
    }
}
