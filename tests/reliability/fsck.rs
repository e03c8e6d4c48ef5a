//! `mapshift fsck`, as whoever keeps a service runs it.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// What `mapshift fsck --full` finds wrong with a data directory.
pub fn faults(data: &Path) -> Vec<String> {
    let checked = Command::new(env!("CARGO_BIN_EXE_mapshift"))
        .args(["fsck", "--full", "--data"])
        .arg(data)
        .output()
        .unwrap();
    let report: Value = match serde_json::from_slice(&checked.stdout) {
        Ok(report) => report,
        Err(_) => {
            return vec![format!(
                "fsck: {}",
                String::from_utf8_lossy(&checked.stderr)
            )];
        }
    };
    let faults = report["faults"].as_array().unwrap();
    faults
        .iter()
        .map(|fault| format!("fsck: {fault}"))
        .collect()
}
