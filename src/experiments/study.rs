//! The whole protocol: the untouched recordings, then each seed's.

use serde::Serialize;

use super::alert::ScoredAlert;
use super::detector::Detector;
use super::drawn::{DrawnObject, altered, choose_objects};
use super::labels::Label;
use super::pictures::{self, Picture};
use super::placed::{PlacedScan, placed_scans};
use super::recording::Recording;
use super::route::RouteRun;
use super::scoring::{Judged, Score, Verdict, against_labels, judge, reach_m};
use super::wilson::Share;
use crate::change::ChangeKind;
use crate::geometry::Vector2;

/// What is to be run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Objects are drawn by this seed …
    pub first_seed: u64,
    /// … and the following ones, up to this number in all.
    pub seeds: u64,
    /// Objects for each seed.
    pub objects: usize,
    /// Real changes of the untouched recordings.
    pub labels: Option<Vec<Label>>,
    /// Whether pictures are drawn.
    pub pictures: bool,
}

impl Options {
    /// Runs of the recordings.
    pub fn runs(&self) -> u64 {
        self.seeds + 1
    }
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
pub struct Study {
    /// The recordings' names.
    pub recordings: Vec<String>,
    /// A row for each detector.
    pub rows: Vec<Row>,
    /// Not in the numbers.
    #[serde(skip)]
    pub pictures: Vec<Picture>,
}

/// A detector's results.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The detector.
    pub detector: Detector,
    /// Over all seeds.
    pub score: Score,
    /// Objects that it missed.
    pub missed: Vec<Place>,
    /// Alerts near no object.
    pub false_alerts: Vec<Place>,
    /// Alerts near an object that are not of its kind.
    pub other_kind_alerts: Vec<Place>,
    /// What it raises on the untouched recordings.
    pub untouched: Vec<Place>,
    /// Labelled changes that it raises there; `None` without labels.
    pub labelled: Option<Share>,
    /// Labelled changes that it does not raise.
    pub labels_missed: Vec<Place>,
}

/// Something at a place.
#[derive(Debug, Clone, Serialize)]
pub struct Place {
    /// The seed that drew it; `None` in the untouched recordings.
    pub seed: Option<u64>,
    /// What it shows.
    pub kind: ChangeKind,
    /// Map frame, metres.
    pub x: f64,
    /// Map frame, metres.
    pub y: f64,
    /// More about it.
    pub note: String,
}

impl Place {
    fn new(seed: Option<u64>, kind: ChangeKind, at: &Vector2<f64>, note: String) -> Self {
        let (x, y) = (at.x, at.y);
        Self {
            seed,
            kind,
            x,
            y,
            note,
        }
    }

    fn of_alert(seed: Option<u64>, alert: &ScoredAlert) -> Self {
        let mut notes: Vec<String> = alert.tier.iter().map(|t| t.name().to_owned()).collect();
        let passes = alert.passes_when_raised;
        notes.extend(passes.map(|passes| format!("raised after {passes} passes")));
        notes.extend(
            alert
                .batch_when_raised
                .map(|batch| format!("in batch {batch}")),
        );
        Self::new(seed, alert.kind, &alert.location, notes.join(", "))
    }
}

/// Scores every detector on recordings with objects drawn into them; calls `after_run` when the
/// recordings have been run once more.
///
/// # Errors
/// If the recordings could not be run at all.
pub fn score_recordings(
    recordings: &[Recording],
    options: &Options,
    mut after_run: impl FnMut(),
) -> anyhow::Result<Study> {
    let sigma_m = recordings.iter().map(|r| r.lidar.range_sigma_m);
    let reach_m = reach_m(sigma_m.fold(0.0, f64::max));
    let known_start = options.labels.is_some();
    let labels = options.labels.as_deref().unwrap_or_default();
    let untouched = RouteRun::of(recordings, known_start)?;
    let untouched_scans = placed_scans(recordings, &untouched.poses);
    let mut study = Study {
        recordings: recordings.iter().map(|r| r.trip.to_string()).collect(),
        rows: Vec::new(),
        pictures: Vec::new(),
    };
    let mut untouched_alerts = Vec::new();
    for detector in Detector::ALL {
        let (alerts, _) = detector.alerts(recordings, &untouched)?;
        let row = untouched_row(detector, &alerts, options.labels.as_deref());
        if options.pictures {
            let name = format!("{}-untouched", file_name(detector));
            let drawn = alert_pictures(&name, &untouched_scans, alerts.iter());
            study.pictures.extend(drawn?);
        }
        study.rows.push(row);
        untouched_alerts.push(alerts);
    }
    after_run();
    for seed in options.first_seed..options.first_seed + options.seeds {
        let objects = choose_objects(recordings, &untouched.poses, options.objects, seed);
        let altered = altered(recordings, &untouched.poses, &objects, seed);
        let run = RouteRun::of(&altered, known_start)?;
        let scans = placed_scans(&altered, &run.poses);
        for ((row, detector), before) in study
            .rows
            .iter_mut()
            .zip(Detector::ALL)
            .zip(&untouched_alerts)
        {
            let (alerts, cpu_s) = detector.alerts(&altered, &run)?;
            let judged = judge(&alerts, &objects, before, labels, reach_m);
            row.score.add(&judged, &alerts, &objects);
            row.score.cpu_s += cpu_s;
            row.score.scans += run.scans;
            row.score.batches += run.batches;
            row.score.batches_not_merged += run.batches_not_merged;
            row.list(seed, &judged, &alerts, &objects);
            if options.pictures {
                let name = format!("{}-{seed}", file_name(detector));
                let drawn = seed_pictures(&name, &scans, &judged, &alerts, &objects);
                study.pictures.extend(drawn?);
            }
        }
        after_run();
    }
    Ok(study)
}

impl Row {
    fn list(
        &mut self,
        seed: u64,
        judged: &Judged,
        alerts: &[ScoredAlert],
        objects: &[DrawnObject],
    ) {
        for (object, found) in objects.iter().zip(&judged.found_by) {
            if found.is_none() {
                let (_, radius_m) = object.shape.bounding_circle();
                let note = format!("{radius_m:.2} m to its farthest corner");
                let place = Place::new(Some(seed), object.kind, &object.centre(), note);
                self.missed.push(place);
            }
        }
        for (alert, verdict) in alerts.iter().zip(&judged.verdicts) {
            let place = || Place::of_alert(Some(seed), alert);
            match verdict {
                Verdict::False => self.false_alerts.push(place()),
                Verdict::OtherKind => self.other_kind_alerts.push(place()),
                Verdict::True | Verdict::Untouched => {}
            }
        }
    }
}

fn untouched_row(detector: Detector, alerts: &[ScoredAlert], labels: Option<&[Label]>) -> Row {
    let (found, explained) = against_labels(alerts, labels.unwrap_or_default());
    let untouched = alerts.iter().zip(explained).map(|(alert, is_labelled)| {
        let mut place = Place::of_alert(None, alert);
        if is_labelled {
            place.note.push_str(", labelled");
        }
        place
    });
    let of_labels = || labels.unwrap_or_default().iter().zip(&found);
    let missed = of_labels().filter(|(_, found)| !**found);
    Row {
        detector,
        score: Score::default(),
        missed: Vec::new(),
        false_alerts: Vec::new(),
        other_kind_alerts: Vec::new(),
        untouched: untouched.collect(),
        labelled: labels.map(|labels| Share {
            hits: of_labels().filter(|(_, found)| **found).count(),
            of: labels.len(),
        }),
        labels_missed: missed
            .map(|(label, _)| Place::new(None, label.kind, &label.location, label.what.clone()))
            .collect(),
    }
}

fn file_name(detector: Detector) -> String {
    detector.name().replace(' ', "-").replace('\'', "")
}

fn alert_pictures<'a>(
    name: &str,
    scans: &[PlacedScan<'_>],
    alerts: impl Iterator<Item = &'a ScoredAlert>,
) -> anyhow::Result<Vec<Picture>> {
    let pictures = alerts.enumerate().map(|(k, alert)| {
        let regions: Vec<_> = alert.sides().map(|(_, region)| region).collect();
        let name = format!("{name}-{k}-{}", alert.kind.name());
        pictures::draw(name, scans, &alert.location, alert.since, &regions)
    });
    pictures.collect()
}

fn seed_pictures(
    name: &str,
    scans: &[PlacedScan<'_>],
    judged: &Judged,
    alerts: &[ScoredAlert],
    objects: &[DrawnObject],
) -> anyhow::Result<Vec<Picture>> {
    let unfit = alerts.iter().zip(&judged.verdicts);
    let unfit = unfit.filter(|(_, v)| matches!(v, Verdict::False | Verdict::OtherKind));
    let name_false = format!("{name}-false");
    let mut pictures = alert_pictures(&name_false, scans, unfit.map(|(alert, _)| alert))?;
    for (k, object) in objects.iter().enumerate() {
        if judged.found_by[k].is_none() {
            let name = format!("{name}-missed-{k}-{}", object.kind.name());
            let outline = object.outline();
            let centre = object.centre();
            pictures.push(pictures::draw(
                name,
                scans,
                &centre,
                object.moment,
                &[&outline],
            )?);
        }
    }
    Ok(pictures)
}

#[cfg(test)]
mod tests {
    use super::super::baselines::testing::room;
    use super::super::recording::in_sequence;
    use super::*;
    use crate::ids::TripId;
    use crate::ingest::CarmenLog;

    fn options(objects: usize) -> Options {
        Options {
            first_seed: 100,
            seeds: 1,
            objects,
            labels: Some(Vec::new()),
            pictures: false,
        }
    }

    #[test]
    fn the_protocol_runs_and_is_the_same_again() {
        let recordings = room(240, None);
        let mut runs = 0;
        let study = score_recordings(&recordings, &options(2), || runs += 1).unwrap();
        assert_eq!(runs, options(2).runs());
        for row in &study.rows {
            assert_eq!(row.score.found.of, 2);
            assert_eq!(row.score.scans, 240);
            assert_eq!(row.score.found.hits + row.missed.len(), 2);
        }
        let mut again = score_recordings(&recordings, &options(2), || {}).unwrap();
        for (row, before) in again.rows.iter_mut().zip(&study.rows) {
            row.score.cpu_s = before.score.cpu_s;
        }
        assert_eq!(
            serde_json::to_value(&again).unwrap(),
            serde_json::to_value(&study).unwrap()
        );
    }

    #[test]
    fn objects_in_a_public_log_are_found() {
        let Ok(data) = std::env::var("MAPSHIFT_DATA") else {
            eprintln!("skipped: MAPSHIFT_DATA is not set");
            return;
        };
        let file = std::fs::File::open(format!("{data}/logs/intel.log.gz")).unwrap();
        let reader = std::io::BufReader::new(flate2::read::GzDecoder::new(file));
        let log = CarmenLog::read(reader).unwrap();
        let recordings = in_sequence([(TripId::new("intel").unwrap(), log.into())]).unwrap();
        let study = score_recordings(&recordings, &options(20), || {}).unwrap();
        let score = &study.rows[0].score;
        eprintln!("found {}, {} false", score.found.text(), score.false_alerts);
        assert!(score.found.hits >= 12 && score.false_alerts <= 2);
    }
}
