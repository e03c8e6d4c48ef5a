//! The service as a process of its own, which can be killed.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A running `mapshift serve`; killed when dropped.
pub struct Process {
    child: Child,
    pub url: String,
}

impl Process {
    pub fn start(data: &Path) -> Self {
        Self::start_on("127.0.0.1:0", data)
    }

    pub fn start_on(address: &str, data: &Path) -> Self {
        Self::start_with(data, &["--listen", address])
    }

    /// With arguments of `mapshift serve`.
    pub fn start_with(data: &Path, arguments: &[&str]) -> Self {
        let mut command = Self::command(data);
        command.args(arguments);
        Self::started(command).expect("the first line names the address")
    }

    /// The command that starts the service; it listens on 127.0.0.1:8080 unless stated otherwise.
    pub fn command(data: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mapshift"));
        command.args(["serve", "--log", "off", "--data"]).arg(data);
        command
    }

    /// Runs a command until it listens; `None` if it ends before.
    pub fn started(mut command: Command) -> Option<Self> {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        let stdout = child.stdout.as_mut().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let address = line.split([' ', ',']).find(|w| w.starts_with("http://"));
        let Some(url) = address.map(ToOwned::to_owned) else {
            let _ = child.kill();
            let _ = child.wait();
            return None;
        };
        Some(Self { child, url })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// SIGKILL, now.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}
