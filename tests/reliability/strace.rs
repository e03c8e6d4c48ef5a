//! `strace` on a running service: what it asks of the kernel, and failures put in its way.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A trace of a process and all its threads. It ends with the process.
pub struct Strace {
    child: Child,
    output: PathBuf,
}

/// Why processes cannot be traced here, if they cannot.
pub fn obstacle() -> Option<String> {
    if !cfg!(target_os = "linux") {
        return Some("strace is a tool of Linux".to_owned());
    }
    let traced = Command::new("strace")
        .args(["-f", "-o", "/dev/null", "true"])
        .output();
    match traced {
        Ok(traced) if traced.status.success() => None,
        Ok(traced) => Some(format!(
            "strace may not trace here: {}",
            String::from_utf8_lossy(&traced.stderr).trim()
        )),
        Err(error) => Some(format!("strace does not run here: {error}")),
    }
}

impl Strace {
    /// Returns once the process is traced.
    pub fn attach(process: u32, arguments: &[&str], output: &Path) -> Self {
        let mut child = Command::new("strace")
            .args(["-f", "-y", "-p", &process.to_string(), "-o"])
            .arg(output)
            .args(arguments)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stderr = child.stderr.as_mut().unwrap();
        BufReader::new(stderr).read_line(&mut line).unwrap();
        assert!(line.contains("attached"), "strace says {line:?}");
        Self {
            child,
            output: output.to_owned(),
        }
    }

    /// Lets go of the process, if it has not yet.
    pub fn detach(&mut self) {
        let process = self.child.id().to_string();
        if self.child.try_wait().unwrap().is_none() {
            Command::new("kill")
                .args(["-TERM", &process])
                .status()
                .unwrap();
            self.child.wait().unwrap();
        }
    }

    /// What was traced, once the process has ended.
    pub fn text(mut self) -> String {
        self.child.wait().unwrap();
        String::from_utf8_lossy(&std::fs::read(&self.output).unwrap()).into_owned()
    }
}

impl Drop for Strace {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
