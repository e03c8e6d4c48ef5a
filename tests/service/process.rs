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
        let mut child = Command::new(env!("CARGO_BIN_EXE_mapshift"))
            .args(["serve", "--listen", address, "--log", "off", "--data"])
            .arg(data)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = child.stdout.as_mut().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let address = line.split([' ', ',']).find(|w| w.starts_with("http://"));
        let url = address
            .expect("the first line names the address")
            .to_owned();
        Self { child, url }
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
