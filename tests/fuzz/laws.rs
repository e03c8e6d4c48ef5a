//! What holds of every decoder, whatever bytes it is given. The fuzz targets look for bytes for which it
//! does not; `tests/decoders.rs` keeps those that were found from coming back.

use mapshift::geometry::Pose2;
use mapshift::ids::{TripId, VehicleId};
use mapshift::ingest::g2o::{read_g2o, write_g2o};
use mapshift::ingest::mcap::TopicChoice;
use mapshift::ingest::{BatchHead, BatchWriter, CarmenLog, Recording, batch_json, edges_json};
use mapshift::model::RecordingFormat;
use mapshift::scan::{LaserScan, decode_scan, encode_scan};

/// What must hold of one decoder for these bytes; panics if it does not.
pub type Law = fn(&[u8]);

/// The decoders by the names of their corpora.
pub const DECODERS: [(&str, Law); 6] = [
    ("batch_json", batch_json),
    ("edges_json", edges_json),
    ("carmen", carmen),
    ("mcap", mcap),
    ("g2o", g2o),
    ("scan", scan),
];

fn received_at() -> jiff::Timestamp {
    jiff::Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_secs(1_795_500_000)
}

fn assert_finite(pose: &Pose2) {
    assert!(pose.is_finite(), "{pose:?}");
}

fn assert_sound(scan: &LaserScan) {
    assert!(scan.ranges_m().flatten().all(f64::is_finite));
    let again = decode_scan(&encode_scan(scan).unwrap()).unwrap();
    assert_eq!(again, *scan);
}

/// What is taken is finite, in the order of time, and survives its compact form; what is not has a reason.
pub fn batch_json(bytes: &[u8]) {
    match batch_json::decode(bytes, received_at()) {
        Ok(batch) => {
            assert!(!batch.scans.is_empty());
            for scan in &batch.scans {
                assert_finite(&scan.odom_from_base);
                assert_sound(&scan.scan);
            }
            let beams: usize = batch.scans.iter().map(|scan| scan.scan.beam_count()).sum();
            let ranges = batch.ranges;
            let readings = ranges.within + ranges.above_range_max + ranges.below_range_min;
            assert!(readings <= beams as u64);
            let extensions = batch.extensions.iter();
            extensions.for_each(|text| assert!(text.starts_with('{') && text.ends_with('}')));
            assert!(batch.scans.is_sorted_by_key(|scan| scan.stamp));
        }
        Err(error) => assert!(!error.detail.is_empty()),
    }
}

/// What is taken is finite.
pub fn edges_json(bytes: &[u8]) {
    match edges_json::decode(bytes, received_at()) {
        Ok(batch) => {
            batch
                .nodes
                .iter()
                .for_each(|node| assert_finite(&node.pose));
            for edge in &batch.edges {
                assert_finite(&edge.measurement);
                assert!(edge.information.is_positive_definite(0.0));
            }
        }
        Err(error) => assert!(!error.detail.is_empty()),
    }
}

/// What is read is finite.
pub fn carmen(bytes: &[u8]) {
    if let Ok(log) = CarmenLog::read(bytes) {
        assert!(!log.scans.is_empty());
        for scan in &log.scans {
            assert_finite(&scan.odom_from_base);
            assert!(
                scan.ranges_m
                    .iter()
                    .flatten()
                    .all(|range_m| range_m.is_finite())
            );
        }
    }
}

/// What is taken of a recording is a trip that the service takes, or there is a reason.
pub fn mcap(bytes: &[u8]) {
    let recording = Recording::open(bytes, RecordingFormat::Mcap, &TopicChoice::default());
    let recording = match recording {
        Ok(recording) => recording,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let head = BatchHead {
        vehicle_id: &VehicleId::new("agv-07").unwrap(),
        trip_id: &TripId::new("monday").unwrap(),
        initial_pose: None,
        lidars: &recording.lidars,
    };
    let mut last = None;
    for batch in BatchWriter::new(head, recording.scans(bytes).unwrap(), 4) {
        let Ok(batch) = batch else { return };
        let batch = batch_json::decode(&batch.json, received_at()).unwrap();
        assert!(batch.scans.is_sorted_by_key(|scan| scan.stamp));
        assert!(last <= batch.scans.first().map(|scan| scan.stamp));
        last = batch.scans.last().map(|scan| scan.stamp);
    }
}

/// What is read and written is read as the same.
pub fn g2o(bytes: &[u8]) {
    let Ok(read) = read_g2o(&String::from_utf8_lossy(bytes)) else {
        return;
    };
    let written = write_g2o(&read.graph);
    let again = read_g2o(&written).unwrap();
    assert_eq!(write_g2o(&again.graph), written);
}

/// What is read is sound; bytes that are compressed already are given as they are, too.
pub fn scan(bytes: &[u8]) {
    let compressed = zstd::bulk::compress(bytes, 1).unwrap();
    for bytes in [bytes, &compressed] {
        if let Ok(scan) = decode_scan(bytes) {
            assert_sound(&scan);
        }
    }
}
