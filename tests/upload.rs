//! The command line against the service: two processes, as a user runs them.

// The lints spare test functions only, not the helpers beside them.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

const MAPSHIFT: &str = env!("CARGO_BIN_EXE_mapshift");

struct Service {
    process: Child,
    url: String,
}

impl Service {
    fn start(data: &Path) -> Self {
        let mut process = Command::new(MAPSHIFT)
            .args(["serve", "--listen", "127.0.0.1:0", "--log", "off", "--data"])
            .arg(data)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = process.stdout.as_mut().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let start = line
            .find("http://")
            .expect("the first line names the address");
        let url = line[start..]
            .split([',', ' ', '\n'])
            .next()
            .unwrap()
            .to_owned();
        Self { process, url }
    }

    fn upload(&self, file: &Path, more: &[&str]) -> Output {
        Command::new(MAPSHIFT)
            .args([
                "upload",
                "--route",
                "line-4",
                "--vehicle",
                "agv-07",
                "--url",
                &self.url,
            ])
            .args(more)
            .arg(file)
            .output()
            .unwrap()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// A gzipped log of 45 looks at a wall from a straight way past it.
fn write_log(path: &Path) {
    let file = std::fs::File::create(path).unwrap();
    let mut encoder = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
    writeln!(encoder, "# made up").unwrap();
    for k in 0..45 {
        let (x, t) = (0.1 * f64::from(k), 1_700_000_000.0 + 0.1 * f64::from(k));
        let ranges: String = (0..90).map(|_| "2.50 ").collect();
        writeln!(
            encoder,
            "ROBOTLASER1 0 -0.785398 1.570796 0.01745329 20 0.01 0 90 {ranges} 0 \
             {x} 0 0 {x} 0 0 0 0 0 0 0 {t} host {t}"
        )
        .unwrap();
    }
    writeln!(encoder, "ODOM 0 0 0 0 0 0 1700000099 host 1").unwrap();
    encoder.finish().unwrap();
}

fn text(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn an_upload_is_safe_to_repeat_and_says_what_it_took() {
    let directory = tempfile::tempdir().unwrap();
    let log = directory.path().join("monday.log.gz");
    write_log(&log);
    let service = Service::start(&directory.path().join("data"));

    let first = service.upload(&log, &["--batch-scans", "20"]);
    assert!(first.status.success(), "{first:?}");
    let said = text(&first);
    assert!(said.contains("route line-4 was made"), "{said}");
    assert!(
        said.contains("45 scans") && said.contains("90 beams"),
        "{said}"
    );
    assert!(said.contains("skipped 1 × another message"), "{said}");
    assert!(said.contains("stored 3 batches (45 scans)"), "{said}");

    let again = service.upload(&log, &["--batch-scans", "20"]);
    assert!(again.status.success(), "{again:?}");
    let said = text(&again);
    assert!(
        said.contains("stored 0 batches") && said.contains("3 were there already"),
        "{said}"
    );

    let other = service.upload(&log, &["--batch-scans", "15"]);
    assert!(!other.status.success());
    let said = text(&other);
    assert!(said.contains("409") && said.contains("--trip"), "{said}");
}

#[test]
fn a_refusal_names_the_place_and_fails() {
    let directory = tempfile::tempdir().unwrap();
    let picture = directory.path().join("map.pgm");
    std::fs::write(&picture, "P5\n1 1\n255\n\0").unwrap();
    let service = Service::start(&directory.path().join("data"));
    let refused = service.upload(&picture, &[]);
    assert!(!refused.status.success());
    assert!(
        text(&refused).contains("is this a CARMEN log?"),
        "{refused:?}"
    );
}

fn recording(name: &str) -> std::path::PathBuf {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings");
    directory.join(name)
}

#[test]
fn a_bag_is_uploaded_and_a_failure_makes_no_route() {
    let directory = tempfile::tempdir().unwrap();
    let service = Service::start(&directory.path().join("data"));
    let bag = recording("turtlebot3.mcap");

    let refused = service.upload(&bag, &["--topic", "/laser"]);
    assert!(!refused.status.success());
    let said = text(&refused);
    assert!(
        said.contains("/laser") && said.contains("/scan (sensor_msgs"),
        "{said}"
    );
    assert!(!said.contains("was made"), "{said}");

    for stored in ["stored 1 batches (30 scans)", "stored 0 batches"] {
        let uploaded = service.upload(&bag, &[]);
        assert!(uploaded.status.success(), "{uploaded:?}");
        let said = text(&uploaded);
        assert!(said.contains("MCAP recording, 30 scans"), "{said}");
        assert!(said.contains("odometry from /odom"), "{said}");
        assert!(
            said.contains("skipped 1 × outside of the odometry"),
            "{said}"
        );
        assert!(said.contains(stored), "{said}");
        assert_eq!(
            said.contains("was made"),
            stored.contains("30 scans"),
            "{said}"
        );
    }
    let two = service.upload(&recording("amr.mcap"), &["--odometry-topic", "/tf"]);
    assert!(two.status.success(), "{two:?}");
    let said = text(&two);
    assert!(
        said.contains("lidar front: 90 beams") && said.contains("lidar rear: 90"),
        "{said}"
    );
    assert!(said.contains("upside down"), "{said}");
    let one = [
        "--topic",
        "/front/scan",
        "--mount-theta",
        "0.8",
        "--trip",
        "front",
    ];
    let one = service.upload(&recording("amr.mcap"), &one);
    assert!(
        one.status.success() && text(&one).contains("45.8°"),
        "{one:?}"
    );
}

/// `mapshift keys`, with somebody's key.
fn keys(more: &[&str], key: &str) -> Output {
    let mut command = Command::new(MAPSHIFT);
    command.arg("keys").args(more).env("MAPSHIFT_KEY", key);
    command.output().unwrap()
}

/// The key that a command has made; the sentence about it is on standard error.
fn made(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    let key = text(output).trim_end().to_owned();
    assert!(
        key.starts_with("ms_") && !key.contains([' ', '\n']),
        "{key}"
    );
    key
}

#[test]
fn keys_are_made_without_a_service_and_with_one() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let data_arg = data.to_str().unwrap();
    let create = [
        "create", "--name", "Kim", "--role", "admin", "--data", data_arg,
    ];
    let admin = made(&keys(&create, ""));

    let service = Service::start(&data);
    let log = directory.path().join("monday.log.gz");
    write_log(&log);
    let refused = service.upload(&log, &[]);
    assert!(!refused.status.success());
    assert!(
        String::from_utf8_lossy(&refused.stderr).contains("401"),
        "{refused:?}"
    );

    let vehicle = [
        "create",
        "--name",
        "agv-07",
        "--role",
        "vehicle",
        "--vehicle",
        "agv-07",
    ];
    let there = ["--url", &service.url];
    let vehicle = made(&keys(&[&vehicle[..], &there].concat(), &admin));
    // Makes the route, which the vehicle may not.
    assert!(
        service
            .upload(&log, &["--trip", "first", "--key", &admin])
            .status
            .success()
    );
    let uploaded = service.upload(&log, &["--key", &vehicle, "--wait"]);
    assert!(uploaded.status.success(), "{uploaded:?}");

    let list = keys(&[&["list"][..], &there].concat(), &admin);
    let list = text(&list);
    assert_eq!(list.lines().count(), 2, "{list}");
    assert!(
        list.contains("admin  Kim") && list.contains("vehicle agv-07"),
        "{list}"
    );
    let id = list.lines().nth(1).unwrap().split(' ').next().unwrap();
    assert!(
        !keys(&[&["revoke", id][..], &there].concat(), &vehicle)
            .status
            .success()
    );
    assert!(
        keys(&[&["revoke", id][..], &there].concat(), &admin)
            .status
            .success()
    );
    let refused = service.upload(&log, &["--key", &vehicle]);
    assert!(!refused.status.success());
}
