//! Recordings that other libraries wrote (`tests/recordings/make_bags.py`), against the same drives as the
//! service's own JSON.

use std::path::PathBuf;

use jiff::Timestamp;

use super::container::TOPICS_MAX;
use super::{McapError, McapSkip, MountOverride, Plan, ScanReader, Survey, TopicChoice};
use crate::geometry::Pose2;
use crate::ids::{StampNs, TripId, VehicleId};
use crate::ingest::batch_json::{self, UploadedBatch};
use crate::ingest::recorded::{RELATIVE_TIMES_NOTE, RecordedScan};
use crate::ingest::{BatchHead, BatchWriter, Recording, RecordingError};
use crate::model::RecordingFormat;

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/recordings")
        .join(name)
}

fn bag(name: &str) -> Vec<u8> {
    std::fs::read(path(&format!("{name}.mcap"))).unwrap()
}

/// The batch that says the same.
fn expected(name: &str) -> UploadedBatch {
    let json = std::fs::read(path(&format!("{name}.json"))).unwrap();
    batch_json::decode(&json, Timestamp::UNIX_EPOCH).unwrap()
}

fn open(bytes: &[u8], choice: &TopicChoice) -> Result<Recording, McapError> {
    match Recording::open(bytes, RecordingFormat::Mcap, choice) {
        Ok(recording) => Ok(recording),
        Err(RecordingError::Mcap(error)) => Err(error),
        Err(error) => panic!("{error}"),
    }
}

/// The one batch of a recording, as the service reads it, and what was skipped.
fn transcoded(bytes: &[u8], choice: &TopicChoice, trip: &str) -> (UploadedBatch, Vec<String>) {
    let recording = open(bytes, choice).unwrap();
    let head = BatchHead {
        vehicle_id: &VehicleId::new("agv-07").unwrap(),
        trip_id: &TripId::new(trip).unwrap(),
        initial_pose: None,
        lidars: &recording.lidars,
    };
    let mut writer = BatchWriter::new(head, recording.scans(bytes).unwrap(), 1_000);
    let batch = writer.next().unwrap().unwrap();
    assert!(writer.next().is_none());
    let skipped = writer.scans().skipped();
    let batch = batch_json::decode(&batch.json, Timestamp::UNIX_EPOCH).unwrap();
    (batch, skipped)
}

fn assert_close(a: f64, b: f64, what: &str) {
    assert!((a - b).abs() < 1e-7, "{what}: {a} and {b}");
}

fn assert_same_pose(a: &Pose2, b: &Pose2, what: &str) {
    let off = a.between(b);
    assert!(
        off.translation().norm() < 1e-7 && off.theta.abs() < 1e-7,
        "{what}: {a:?} and {b:?}"
    );
}

fn assert_same(found: &UploadedBatch, expected: &UploadedBatch) {
    assert_eq!(found.scans.len(), expected.scans.len());
    for (k, (found, expected)) in found.scans.iter().zip(&expected.scans).enumerate() {
        let what = format!("scan {k}");
        assert_eq!(found.stamp, expected.stamp, "{what}");
        assert_eq!(found.lidar, expected.lidar, "{what}");
        assert_same_pose(&found.odom_from_base, &expected.odom_from_base, &what);
        assert_close(found.beam_interval_s, expected.beam_interval_s, &what);
        let (a, b) = (found.scan.lidar(), expected.scan.lidar());
        assert_same_pose(&a.mount, &b.mount, &what);
        assert_close(a.angle_min_rad, b.angle_min_rad, &what);
        assert_close(a.angle_increment_rad, b.angle_increment_rad, &what);
        assert_close(a.range_min_m, b.range_min_m, &what);
        assert_close(a.range_max_m, b.range_max_m, &what);
        assert_eq!(found.scan.ticks(), expected.scan.ticks(), "{what}");
    }
}

#[test]
fn bags_of_public_robots_are_what_their_json_says() {
    for name in ["turtlebot3", "turtlebot4", "amr", "foxglove"] {
        let (found, skipped) = transcoded(&bag(name), &TopicChoice::default(), name);
        assert_same(&found, &expected(name));
        match name {
            "turtlebot3" => assert!(
                skipped[0].starts_with("1 × outside of the odometry"),
                "{skipped:?}"
            ),
            _ => assert!(skipped.is_empty(), "{name}: {skipped:?}"),
        }
    }
}

#[test]
fn odometry_from_transforms_is_that_from_its_topic() {
    let choice = TopicChoice {
        odometry: Some("/tf".into()),
        ..TopicChoice::default()
    };
    let (found, _) = transcoded(&bag("turtlebot3"), &choice, "turtlebot3");
    assert_same(&found, &expected("turtlebot3"));
}

#[test]
fn one_lidar_of_several_can_be_taken_and_its_mount_stated() {
    let choice = TopicChoice {
        lidars: vec!["/rear/scan".into()],
        mount: MountOverride {
            theta: Some(-2.25),
            ..MountOverride::default()
        },
        ..TopicChoice::default()
    };
    let recording = open(&bag("amr"), &choice).unwrap();
    let [rear] = recording.lidars.as_slice() else {
        panic!("{:?}", recording.lidars);
    };
    assert_eq!(rear.name, None);
    assert_eq!(rear.geometry.mount, Pose2::new(-0.4, -0.3, -2.25));
    assert!(
        recording
            .notes
            .iter()
            .any(|note| note.contains("upside down"))
    );
    let both = TopicChoice {
        lidars: Vec::new(),
        ..choice
    };
    assert!(matches!(
        open(&bag("amr"), &both),
        Err(McapError::Topics { .. })
    ));
}

#[test]
fn a_topic_that_is_not_there_is_answered_with_those_that_are() {
    let wanted = |lidars: &[&str], odometry: Option<&str>| TopicChoice {
        lidars: lidars.iter().map(|topic| (*topic).to_owned()).collect(),
        odometry: odometry.map(str::to_owned),
        ..TopicChoice::default()
    };
    let bytes = bag("turtlebot3");
    for choice in [
        wanted(&["/laser"], None),
        wanted(&["/odom"], None),
        wanted(&[], Some("/pose")),
    ] {
        let error = open(&bytes, &choice).unwrap_err().to_string();
        assert!(
            error.contains("/scan (sensor_msgs/msg/LaserScan, cdr: 31 messages)"),
            "{error}"
        );
        assert!(
            error.contains("/rosout (std_msgs/msg/String, cdr: 1 messages)"),
            "{error}"
        );
    }
}

/// A record of the container.
fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

fn chunk(uncompressed_bytes: u64, crc: u32, compression: &str, records: &[u8]) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(uncompressed_bytes.to_le_bytes());
    body.extend(crc.to_le_bytes());
    body.extend((compression.len() as u32).to_le_bytes());
    body.extend(compression.bytes());
    body.extend((records.len() as u64).to_le_bytes());
    body.extend(records);
    record(6, &body)
}

fn file(records: &[Vec<u8>]) -> Vec<u8> {
    [super::MAGIC.to_vec(), records.concat()].concat()
}

#[test]
fn bombs_are_refused_before_they_are_unpacked() {
    let zeros = vec![0; 32 << 20];
    let bomb = zstd::bulk::compress(&zeros, 3).unwrap();
    let header = record(1, &[0; 8]);
    let honest = file(&[header.clone(), chunk(32 << 20, 0, "zstd", &bomb)]);
    let error = Survey::of(honest.as_slice()).unwrap_err();
    assert!(
        matches!(error, McapError::ChunkTooLarge { offset: 25, .. }),
        "{error}"
    );
    // One that states less than it becomes.
    let lying = file(&[header, chunk(1_000, 0, "zstd", &bomb)]);
    let error = Survey::of(lying.as_slice()).unwrap_err();
    assert!(
        matches!(error, McapError::Damaged { offset: 25, .. }),
        "{error}"
    );
    let endless = file(&[record(6, &[0; 8])[..9].to_vec()]);
    let endless = [&endless[..9], &u64::MAX.to_le_bytes()[..]].concat();
    let error = Survey::of(endless.as_slice()).unwrap_err();
    assert!(
        matches!(error, McapError::ChunkTooLarge { offset: 8, .. }),
        "{error}"
    );
}

#[test]
fn damage_is_named_with_its_place() {
    let mut bytes = bag("amr");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    let error = Survey::of(bytes.as_slice()).unwrap_err().to_string();
    assert!(error.starts_with("the record at byte "), "{error}");
    let unknown = file(&[chunk(4, 0, "snappy", b"1234")]);
    let error = Survey::of(unknown.as_slice()).unwrap_err().to_string();
    assert!(
        error.contains("byte 8") && error.contains("snappy"),
        "{error}"
    );
    assert!(matches!(
        Survey::of(&b"P5 1 1"[..]),
        Err(McapError::NoMagic)
    ));
}

#[test]
fn a_file_without_its_end_is_read_as_far_as_it_goes() {
    let bytes = bag("amr");
    let whole = Survey::of(bytes.as_slice()).unwrap();
    assert_eq!(whole.cut_at, None);
    let count = |bytes: &[u8]| {
        let survey = Survey::of(bytes).unwrap();
        let plan = Plan::of(&survey, &TopicChoice::default()).unwrap();
        let scans = ScanReader::new(&plan, bytes).unwrap();
        let read: Vec<_> = scans.map(|scan| scan.unwrap().1).collect();
        assert!(read.is_sorted_by_key(|scan| scan.stamp));
        (read.len(), plan.notes)
    };
    let (all, _) = count(&bytes);
    assert_eq!(all, 40);
    let mut before = 0;
    for share in [3, 5, 7] {
        let (some, notes) = count(&bytes[..bytes.len() * share / 10]);
        assert!((before..all).contains(&some), "{some} of {all}");
        assert!(
            notes.iter().any(|note| note.contains("loss of power")),
            "{notes:?}"
        );
        before = some;
    }
    assert!(before > 10, "{before}");
}

#[test]
fn a_bag_without_transforms_needs_a_mount() {
    let mut survey = Survey::of(bag("turtlebot4").as_slice()).unwrap();
    survey.transforms = Default::default();
    let error = Plan::of(&survey, &TopicChoice::default())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("rplidar_link to base_link") && error.contains("mount_x"),
        "{error}"
    );
    let choice = TopicChoice {
        mount: MountOverride {
            x: Some(0.1),
            ..MountOverride::default()
        },
        ..TopicChoice::default()
    };
    let plan = Plan::of(&survey, &choice).unwrap();
    assert_eq!(plan.lidars[0].geometry.mount, Pose2::new(0.1, 0.0, 0.0));
}

#[test]
fn lengths_that_no_file_has_are_damage() {
    let mut body = vec![0; 32];
    body.extend(u64::MAX.to_le_bytes());
    let bytes = file(&[record(6, &body)]);
    assert_eq!(bytes.len(), 57);
    let error = Survey::of(bytes.as_slice()).unwrap_err();
    assert!(
        matches!(error, McapError::Damaged { offset: 8, .. }),
        "{error}"
    );
    let cut = Survey::of(&bytes[..56]).unwrap();
    assert_eq!(cut.cut_at, Some(8));
}

fn text(value: &str) -> Vec<u8> {
    [&(value.len() as u32).to_le_bytes()[..], value.as_bytes()].concat()
}

fn schema(id: u16, name: &str) -> Vec<u8> {
    let id = id.to_le_bytes();
    record(3, &[&id[..], &text(name), &text(""), &text("")].concat())
}

fn channel(id: u16, schema: u16, topic: &str) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    record(4, &[ids, text(topic), text("json"), text("")].concat())
}

fn message(channel: u16, milliseconds: u64, json: &str) -> Vec<u8> {
    let (channel, sequence) = (channel.to_le_bytes(), 0_u32.to_le_bytes());
    let time = (milliseconds * 1_000_000).to_le_bytes();
    let head = [&channel[..], &sequence, &time, &time].concat();
    record(5, &[&head[..], json.as_bytes()].concat())
}

/// A scan of Foxglove's: milliseconds, the first and the last angle, and the ranges.
type Sweep<'a> = (u64, [f64; 2], &'a str);

/// A recording in Foxglove's messages of a vehicle that stands for 4 s.
fn standing(sweeps: &[Sweep<'_>]) -> Vec<u8> {
    let mut records = vec![
        schema(1, "foxglove.LaserScan"),
        schema(2, "foxglove.PoseInFrame"),
        channel(1, 1, "/scan"),
        channel(2, 2, "/odom"),
    ];
    let pose = r#"{"pose":{"orientation":{"w":1}}}"#;
    records.extend((0..=4).map(|second| message(2, 1_000 * second, pose)));
    records.extend(sweeps.iter().map(|(milliseconds, [first, last], ranges)| {
        let angles = format!(r#""start_angle":{first},"end_angle":{last}"#);
        let json = format!(r#"{{"frame_id":"laser",{angles},"ranges":[{ranges}]}}"#);
        message(1, *milliseconds, &json)
    }));
    file(&records)
}

fn plan_of_standing(bytes: &[u8]) -> Plan {
    let choice = TopicChoice {
        mount: MountOverride {
            x: Some(0.0),
            ..MountOverride::default()
        },
        ..TopicChoice::default()
    };
    Plan::of(&Survey::of(bytes).unwrap(), &choice).unwrap()
}

fn scans_of<'a>(reader: &mut ScanReader<'a, &'a [u8]>) -> Vec<RecordedScan> {
    reader.map(|scan| scan.unwrap().1).collect()
}

#[test]
fn scans_with_other_beams_are_put_at_those_of_the_first() {
    let bytes = standing(&[
        (1_000, [-1.0, 1.0], "1,2,3,4,5"),
        (1_100, [-1.0, 0.5], "1,2,3,4"),
        (1_200, [-1.5, 1.1], "9,1,2,3,4,5"),
        (1_300, [2.0, 2.5], "1,2"),
        (1_400, [-0.9, 1.1], "1,2,3,4,5"),
    ]);
    let plan = plan_of_standing(&bytes);
    let mut reader = ScanReader::new(&plan, bytes.as_slice()).unwrap();
    let scans = scans_of(&mut reader);
    let whole = [1.0, 2.0, 3.0, 4.0, 5.0].map(Some).to_vec();
    let mut without_last = whole.clone();
    without_last[4] = Some(0.0);
    let found: Vec<_> = scans.into_iter().map(|scan| scan.ranges_m).collect();
    assert_eq!(found, [whole.clone(), without_last, whole.clone(), whole]);
    assert_eq!(reader.resampled(), 2);
    let skipped: Vec<_> = reader.skipped().iter().collect();
    assert_eq!(skipped, [(&McapSkip::OtherGeometry, &1)]);
}

#[test]
fn simulated_times_stay_as_they_are() {
    let bytes = standing(&[(1_500, [-1.0, 1.0], "1,2,3,4,5")]);
    let plan = plan_of_standing(&bytes);
    assert!(plan.notes.iter().any(|note| note == RELATIVE_TIMES_NOTE));
    let scans = scans_of(&mut ScanReader::new(&plan, bytes.as_slice()).unwrap());
    assert_eq!(scans[0].stamp, StampNs(1_500_000_000));
    assert!(scans[0].stamp.is_simulated());
}

#[test]
fn a_whole_turn_clockwise_is_one_counter_clockwise() {
    use std::f64::consts::{PI, TAU};
    let bytes = standing(&[(1_000, [-PI, -PI - 6.2], "1,2,3,4,5,6,7,8,9,10,11")]);
    let plan = plan_of_standing(&bytes);
    let lidar = &plan.lidars[0].geometry;
    assert_close(lidar.angle_min_rad, TAU - PI - 6.2, "angle_min");
    assert_close(lidar.angle_increment_rad, 0.62, "angle_increment");
    let scans = scans_of(&mut ScanReader::new(&plan, bytes.as_slice()).unwrap());
    assert_eq!(scans[0].ranges_m[0], Some(11.0));
}

#[test]
fn few_beams_wait_for_earlier_scans() {
    let ranges = vec!["1"; 8_192].join(",");
    let fan = [-3.0, 3.0];
    let mut sweeps: Vec<Sweep<'_>> = (1..=260).map(|k| (1_000 + k, fan, &ranges[..])).collect();
    sweeps.push((1_000, fan, &ranges[..]));
    let bytes = standing(&sweeps);
    let plan = plan_of_standing(&bytes);
    let mut reader = ScanReader::new(&plan, bytes.as_slice()).unwrap();
    assert_eq!(scans_of(&mut reader).len(), 260);
    // It came after some had to be given.
    assert_eq!(reader.skipped()[&McapSkip::NotLater], 1);
}

#[test]
fn topics_are_few_and_stay_what_they_are() {
    let topics = |count: usize| {
        let names = (0..count).map(|id| channel(id as u16, 1, &format!("/{id}")));
        let mut records = vec![schema(1, "foxglove.LaserScan")];
        records.extend(names);
        // Writers repeat them.
        records.push(channel(0, 1, "/0"));
        records
    };
    let most = file(&topics(TOPICS_MAX));
    assert!(Survey::of(most.as_slice()).is_ok());
    let error = Survey::of(file(&topics(TOPICS_MAX + 1)).as_slice()).unwrap_err();
    assert!(matches!(error, McapError::TooManyTopics(_)), "{error}");
    let mut other = topics(1);
    other.push(channel(0, 1, "/other"));
    let error = Survey::of(file(&other).as_slice()).unwrap_err();
    assert!(
        matches!(error, McapError::Damaged { .. }) && error.to_string().contains("channel 0"),
        "{error}"
    );
}
