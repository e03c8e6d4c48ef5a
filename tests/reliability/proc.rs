//! What the kernel says of a running process.

use std::path::Path;

/// Why nothing is known of processes here, if nothing is.
pub fn obstacle() -> Option<String> {
    let is_known = Path::new("/proc/self/status").exists();
    (!is_known).then(|| "there is no /proc, where memory and descriptors are read".to_owned())
}

/// Resident memory of a process, bytes.
pub fn resident_bytes(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|text| text.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap() * 1024
}

/// Open descriptors of a process.
pub fn descriptors(process: u32) -> usize {
    let open = std::fs::read_dir(format!("/proc/{process}/fd")).unwrap();
    open.count()
}
