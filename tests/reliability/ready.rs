//! How long a service takes from its start until it says that it is ready.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::client::Client;
use crate::process::Process;

const POLL: Duration = Duration::from_millis(1);
const PATIENCE: Duration = Duration::from_secs(60);

/// A service and the time it took; `None` if it ends before, or is never ready.
pub async fn start(data: &Path) -> Option<(Process, Duration)> {
    let began = Instant::now();
    let mut command = Process::command(data);
    command.args(["--listen", "127.0.0.1:0"]);
    let process = Process::started(command)?;
    let client = Client::new(&process.url);
    while client.status_of("/readyz").await != 200 {
        if began.elapsed() > PATIENCE {
            return None;
        }
        tokio::time::sleep(POLL).await;
    }
    Some((process, began.elapsed()))
}
