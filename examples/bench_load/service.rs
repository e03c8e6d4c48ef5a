//! The service as a child process.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};

use anyhow::Context;
use mapshift::api::{AccessOptions, Limits};
use mapshift::app;
use mapshift::config::{AppConfig, temporary_data_dir};
use mapshift::pipeline::PipelineOptions;
use mapshift::webhooks::DeliveryOptions;

/// `sysconf(_SC_CLK_TCK)`, which Linux has at 100 on all common machines.
const TICKS_PER_S: f64 = 100.0;

/// The service, until the other end of its standard input closes.
pub async fn serve() -> anyhow::Result<()> {
    let data_dir = temporary_data_dir();
    let config = AppConfig {
        listen: ([127, 0, 0, 1], 0).into(),
        data_dir: data_dir.clone(),
        accept_lost_log: false,
        limits: Limits::default(),
        pipeline: PipelineOptions::default(),
        delivery: DeliveryOptions::default(),
        access: AccessOptions::default(),
        insecure_open_to_network: false,
    };
    let service = app::start(config).await?;
    writeln!(std::io::stdout(), "http://{}", service.local_addr())?;
    let closed = tokio::task::spawn_blocking(|| std::io::stdin().read_line(&mut String::new()));
    closed.await??;
    service.shutdown().await?;
    Ok(std::fs::remove_dir_all(data_dir)?)
}

/// The service as a process, whose processor time can be distinguished from the vehicles'.
pub struct Service {
    child: Child,
    /// Where it listens.
    pub url: String,
}

impl Service {
    /// Starts this program once more, as the service.
    pub fn start() -> anyhow::Result<Self> {
        let mut child = Command::new(std::env::current_exe()?)
            .arg("serve")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let stdout = child.stdout.take().context("no output")?;
        let mut url = String::new();
        BufReader::new(stdout).read_line(&mut url)?;
        let url = url.trim().to_owned();
        Ok(Self { child, url })
    }

    /// User and system time so far, seconds.
    pub fn processor_s(&self) -> anyhow::Result<f64> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id()))?;
        // The name in brackets may hold spaces.
        let (_, after_name) = stat.rsplit_once(')').context("no name")?;
        let fields: Vec<&str> = after_name.split_whitespace().collect();
        let ticks = |k: usize| fields.get(k).and_then(|text| text.parse::<f64>().ok());
        let (user, system) = ticks(11).zip(ticks(12)).context("no times")?;
        Ok((user + system) / TICKS_PER_S)
    }

    /// The most memory it has had.
    pub fn peak_memory(&self) -> anyhow::Result<String> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id()))?;
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        Ok(peak.context("no peak")?.trim().to_owned())
    }

    /// Ends it in order.
    pub fn stop(mut self) -> anyhow::Result<()> {
        drop(self.child.stdin.take());
        let status = self.child.wait()?;
        anyhow::ensure!(status.success(), "the service ended with {status}");
        Ok(())
    }
}
