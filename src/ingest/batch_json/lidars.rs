//! The lidars of a batch: one, or several with names.

use std::f64::consts::PI;
use std::sync::Arc;

use super::raw;
use super::uploaded::LIDARS_MAX;
use super::values::pose;
use crate::geometry::Pose2;
use crate::ids::{LidarId, StampNs};
use crate::ingest::body_error::{BatchProblem, Checked, refuse};
use crate::ingest::json::Object;
use crate::mapping::LidarOfVehicle;
use crate::scan::{BandError, BandView, HeightBand, Lidar, LidarError, RANGE_SIGMA_DEFAULT_M};

/// A sweep takes no longer than this, seconds …
const SCAN_TIME_MAX_S: f64 = 2.0;
/// … and no longer than the stated time between scans, with this for rounding.
const SCAN_TIME_SLACK: f64 = 1.05;

/// A lidar as stated.
pub(super) struct StatedLidar {
    pointer: String,
    which: LidarOfVehicle,
    /// For a clockwise lidar `angle_min_rad` is that of the first beam, from which angles decrease.
    geometry: Lidar,
    is_clockwise: bool,
    angle_max_rad: Option<f64>,
    time_increment_s: Option<f64>,
    scan_time_s: Option<f64>,
}

/// A lidar of the batch with the common properties of its scans.
pub(super) struct SendingLidar {
    /// Its index and name on the vehicle.
    pub which: LidarOfVehicle,
    /// Its geometry, counter-clockwise.
    pub geometry: Arc<Lidar>,
    /// Whether its beams were sent in clockwise order.
    pub is_clockwise: bool,
    /// Beams of its first scan; all others have as many.
    pub beams: usize,
    /// From one beam to the next, seconds; below 0 for clockwise scans.
    pub beam_interval_s: f64,
    last_stamp: Option<StampNs>,
}

/// The lidars of a batch, at least one.
pub(super) struct Lidars(Vec<SendingLidar>);

/// The lidars that a batch states, as `lidar` or as `lidars`.
pub(super) fn stated(
    one: Option<Object<raw::Lidar>>,
    several: Option<raw::Lidars>,
) -> Checked<Vec<StatedLidar>> {
    match (one, several) {
        (Some(Object(one)), None) => Ok(vec![stated_alone(one)?]),
        (None, Some(several)) => stated_by_name(several),
        (None, None) => refuse(
            BatchProblem::InvalidField,
            "",
            "missing field `lidar`: state the geometry of the lidar as `lidar`, or of several as `lidars`".into(),
        ),
        (Some(_), Some(_)) => refuse(
            BatchProblem::InvalidField,
            "/lidars",
            "a batch states either `lidar` or `lidars`: leave `lidar` out if the vehicle has several".into(),
        ),
    }
}

fn stated_alone(raw: raw::Lidar) -> Checked<StatedLidar> {
    if raw.id.is_some() {
        return refuse(
            BatchProblem::MalformedJson,
            "/lidar/id",
            "unknown field `id`: only lidars of `lidars` have names".into(),
        );
    }
    StatedLidar::checked(raw, LidarOfVehicle::default(), "/lidar".into())
}

fn stated_by_name(raw: raw::Lidars) -> Checked<Vec<StatedLidar>> {
    if !(1..=LIDARS_MAX).contains(&raw.count) {
        let detail = format!(
            "a vehicle has 1 to {LIDARS_MAX} lidars, this one {}",
            raw.count
        );
        return refuse(BatchProblem::InvalidField, "/lidars", detail);
    }
    let mut lidars: Vec<StatedLidar> = Vec::with_capacity(raw.count);
    for (place, raw) in raw.kept.into_iter().enumerate() {
        let pointer = format!("/lidars/{place}");
        let Some(id) = raw.id.clone() else {
            let detail =
                "missing field `id`: name each lidar, so that scans can say which took them";
            return refuse(BatchProblem::InvalidField, pointer, detail.into());
        };
        let which = LidarOfVehicle {
            name: Some(id),
            place,
        };
        if lidars.iter().any(|other| other.which.name == which.name) {
            return refuse(
                BatchProblem::InvalidField,
                format!("{pointer}/id"),
                "a lidar before has the same id".into(),
            );
        }
        lidars.push(StatedLidar::checked(raw, which, pointer)?);
    }
    Ok(lidars)
}

/// The lidar stated at a pointer, counter-clockwise or not.
fn lidar(raw: raw::Lidar, pointer: &str) -> Checked<Lidar> {
    let mount = match raw.mount {
        Some(Object(mount)) => pose(mount, &format!("{pointer}/mount"))?,
        None => Pose2::IDENTITY,
    };
    let lidar = Lidar {
        angle_min_rad: raw.angle_min,
        angle_increment_rad: raw.angle_increment.abs(),
        range_min_m: raw.range_min,
        range_max_m: raw.range_max,
        mount,
        range_sigma_m: raw.range_sigma.unwrap_or(RANGE_SIGMA_DEFAULT_M),
        band: raw.band.map(|band| band_view(&band.0, raw.range_max)),
    };
    lidar.validated().or_else(|error| {
        let error = match error {
            LidarError::AngleIncrement(_) => LidarError::AngleIncrement(raw.angle_increment),
            other => other,
        };
        let (problem, field) = match &error {
            LidarError::AngleMin(_) => (BatchProblem::ScanGeometry, "angle_min"),
            LidarError::AngleIncrement(_) => (BatchProblem::ScanGeometry, "angle_increment"),
            LidarError::RangeMin { .. } => (BatchProblem::ScanGeometry, "range_min"),
            LidarError::RangeMax(_) => (BatchProblem::ScanGeometry, "range_max"),
            LidarError::Mount => (BatchProblem::OutOfRange, "mount"),
            LidarError::RangeSigma(_) => (BatchProblem::OutOfRange, "range_sigma"),
            LidarError::Band(error) => (BatchProblem::OutOfRange, band_field(error)),
        };
        refuse(problem, format!("{pointer}/{field}"), error.to_string())
    })
}

fn band_view(raw: &raw::Band, range_max_m: f64) -> BandView {
    let band = HeightBand {
        from_m: raw.from,
        to_m: raw.to,
    };
    let all_the_way = BandView::all_the_way(band, range_max_m);
    BandView {
        clear_from_m: raw.clear_from.unwrap_or(all_the_way.clear_from_m),
        clear_to_m: raw.clear_to.unwrap_or(all_the_way.clear_to_m),
        ..all_the_way
    }
}

fn band_field(error: &BandError) -> &'static str {
    match error {
        BandError::Height { .. } | BandError::Thin { .. } => "band",
        BandError::Clear { .. } => "band/clear_from",
    }
}

impl StatedLidar {
    fn checked(raw: raw::Lidar, which: LidarOfVehicle, pointer: String) -> Checked<Self> {
        Ok(Self {
            angle_max_rad: raw.angle_max,
            time_increment_s: raw.time_increment,
            scan_time_s: raw.scan_time,
            is_clockwise: raw.angle_increment < 0.0,
            geometry: lidar(raw, &pointer)?,
            which,
            pointer,
        })
    }

    /// Completed by the number of beams of its first scan; `None` without a scan.
    fn sending(self, beams: Option<usize>) -> Checked<SendingLidar> {
        let (lidar, pointer) = (&self.geometry, self.pointer.as_str());
        if let (Some(beams), Some(angle_max_rad)) = (beams, self.angle_max_rad) {
            self.check_angle_max(angle_max_rad, beams)?;
        }
        let beams = beams.unwrap_or(0);
        let (increment_s, scan_s) = (self.time_increment_s, self.scan_time_s);
        let interval_s = beam_interval_s(lidar, beams, increment_s, scan_s, pointer)?;
        let is_clockwise = self.is_clockwise;
        Ok(SendingLidar {
            beam_interval_s: if is_clockwise {
                -interval_s
            } else {
                interval_s
            },
            which: self.which,
            geometry: Arc::new(match is_clockwise {
                true => self.geometry.counter_clockwise(beams),
                false => self.geometry,
            }),
            is_clockwise,
            beams,
            last_stamp: None,
        })
    }

    /// Where `angle_max` is sent it must fit the beams to within one.
    fn check_angle_max(&self, angle_max_rad: f64, beams: usize) -> Checked<()> {
        let Lidar {
            angle_min_rad,
            angle_increment_rad,
            ..
        } = self.geometry;
        let (covered_rad, side) = match self.is_clockwise {
            true => (angle_min_rad - angle_max_rad, "below"),
            false => (angle_max_rad - angle_min_rad, "above"),
        };
        let expected = covered_rad / angle_increment_rad + 1.0;
        let detail = if covered_rad <= 0.0 {
            format!("angle_max {angle_max_rad} must be {side} angle_min {angle_min_rad}")
        } else if (expected - beams as f64).abs() > 1.5 {
            format!(
                "angle_min, angle_max and angle_increment make {expected:.0} beams, the scans have {beams}"
            )
        } else {
            return Ok(());
        };
        let pointer = format!("{}/angle_max", self.pointer);
        refuse(BatchProblem::ScanGeometry, pointer, detail)
    }
}

impl Lidars {
    /// Those stated, as the scans use them.
    pub fn of(stated: Vec<StatedLidar>, scans: &[raw::Scan]) -> Checked<Self> {
        let sending = stated.into_iter().map(|lidar| {
            let first = scans.iter().find(|scan| scan.lidar == lidar.which.name);
            lidar.sending(first.map(|scan| scan.ranges.count))
        });
        Ok(Self(sending.collect::<Checked<_>>()?))
    }

    /// The lidar that took the scan at place `k`, by the name that the scan gives.
    pub fn that_took(&mut self, k: usize, named: Option<&LidarId>) -> Checked<&mut SendingLidar> {
        let has_names = self.0.iter().any(|lidar| lidar.which.name.is_some());
        let found = self.0.iter();
        let found = found
            .enumerate()
            .find(|(_, l)| l.which.name.as_ref() == named);
        match (found, named) {
            (Some((place, _)), _) => Ok(&mut self.0[place]),
            (None, None) => refuse(
                BatchProblem::InvalidField,
                format!("/scans/{k}"),
                format!(
                    "missing field `lidar`: which of {} took the scan?",
                    self.names()
                ),
            ),
            (None, Some(name)) if has_names => refuse(
                BatchProblem::InvalidField,
                format!("/scans/{k}/lidar"),
                format!("the batch has no lidar {name}; it has {}", self.names()),
            ),
            (None, Some(_)) => refuse(
                BatchProblem::MalformedJson,
                format!("/scans/{k}/lidar"),
                "unknown field `lidar`: scans name their lidar only in a batch with `lidars`"
                    .into(),
            ),
        }
    }

    fn names(&self) -> String {
        let names = self.0.iter().filter_map(|lidar| lidar.which.name.as_ref());
        names.map(LidarId::as_str).collect::<Vec<_>>().join(", ")
    }
}

impl SendingLidar {
    /// How a refusal names its scans.
    pub fn scans_of(&self) -> String {
        let named = self.which.name.as_ref();
        named.map_or_else(|| "a batch".into(), |name| format!("lidar {name}"))
    }

    /// Checks the stamp of its next scan, at index `k`.
    pub fn check_stamp(&mut self, k: usize, stamp: StampNs) -> Checked<()> {
        if self.last_stamp.is_some_and(|last| stamp <= last) {
            let detail = format!(
                "the stamps of {} must increase strictly; this one is not after the one before it",
                self.scans_of()
            );
            return refuse(
                BatchProblem::TimestampOrder,
                format!("/scans/{k}/stamp"),
                detail,
            );
        }
        self.last_stamp = Some(stamp);
        Ok(())
    }
}

/// `time_increment` if it is sent; else that of a lidar that turns once in `scan_time`; else 0.
fn beam_interval_s(
    lidar: &Lidar,
    beams: usize,
    time_increment_s: Option<f64>,
    scan_time_s: Option<f64>,
    pointer: &str,
) -> Checked<f64> {
    if let Some(scan_time_s) = scan_time_s
        && !(0.0..=SCAN_TIME_MAX_S).contains(&scan_time_s)
    {
        let detail = format!("scan_time {scan_time_s} is not within 0 to {SCAN_TIME_MAX_S} s");
        return refuse(
            BatchProblem::OutOfRange,
            format!("{pointer}/scan_time"),
            detail,
        );
    }
    let per_turn_s = scan_time_s.unwrap_or(0.0);
    let interval_s =
        time_increment_s.unwrap_or(per_turn_s * lidar.angle_increment_rad / (2.0 * PI));
    let sweep_s = interval_s * beams.saturating_sub(1) as f64;
    let longest_s = match scan_time_s {
        Some(scan_time_s) if scan_time_s > 0.0 => SCAN_TIME_SLACK * scan_time_s,
        _ => SCAN_TIME_MAX_S,
    };
    if interval_s >= 0.0 && sweep_s <= longest_s {
        return Ok(interval_s);
    }
    let detail = format!(
        "time_increment {interval_s} for {beams} beams makes a scan of {sweep_s:.3} s, which is \
         not within 0 to {longest_s:.3} s: it is the time from one beam to the next, in seconds"
    );
    refuse(
        BatchProblem::OutOfRange,
        format!("{pointer}/time_increment"),
        detail,
    )
}
