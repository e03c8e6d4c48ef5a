//! One line of a CARMEN log.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;
use std::str::SplitAsciiWhitespace;

use crate::geometry::Pose2;
use crate::scan::{BEAMS_MAX, Lidar, RANGE_SIGMA_DEFAULT_M};

/// Hokuyo lidars write error codes as ranges of less than 20 mm.
const RANGE_MIN_M: f64 = 0.02;
/// `FLASER` lines do not state a maximum range; SICK LMS lidars write 81 m and more for no return.
const FLASER_RANGE_MAX_M: f64 = 81.0;
/// Larger coordinates are not poses, metres.
const POSITION_MAX_M: f64 = 1e6;
/// Latest time of a scan: 2100-01-01, seconds since the Unix epoch.
const STAMP_MAX_S: f64 = 4_102_444_800.0;

/// Why a line of a recording gave no scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SkipReason {
    /// Not a scan, or of a second lidar.
    OtherMessage,
    /// The line is longer than any scan.
    TooLong,
    /// The line ends before its fields do.
    Truncated,
    /// A field is not a finite number of plausible size.
    NotANumber,
    /// The number of beams is 0, too large, or one whose field of view is not known.
    BeamCount,
    /// The lidar or its mount is not that of the first scan.
    OtherLidar,
    /// The time is not later than that of the scan before.
    NotLater,
}

impl fmt::Display for SkipReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OtherMessage => "another message than a scan of this lidar",
            Self::TooLong => "longer than any scan",
            Self::Truncated => "the line ends early",
            Self::NotANumber => "a field is not a believable number",
            Self::BeamCount => "a number of beams that cannot be right",
            Self::OtherLidar => "the lidar or its mount differs from the first scan",
            Self::NotLater => "the time is not later than the scan before",
        })
    }
}

/// The two messages that hold a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Message {
    /// `ROBOTLASER1`: geometry, ranges, remissions, laser pose, robot pose, …
    RobotLaser,
    /// `FLASER`: ranges over half a turn, laser pose, robot pose, …
    FrontLaser,
}

/// The content of a line.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Line {
    pub message: Message,
    pub lidar: Lidar,
    pub odom_from_base: Pose2,
    /// Seconds, in the log's own clock.
    pub time_s: f64,
    /// Metres, `None` for no return, 0 for an invalid reading.
    pub ranges_m: Vec<Option<f64>>,
}

/// Reads a line; `None` for comments and blank lines.
pub(super) fn parse_line(line: &str) -> Option<Result<Line, SkipReason>> {
    let mut fields = Fields(line.split_ascii_whitespace());
    match fields.0.next()? {
        word if word.starts_with('#') => None,
        "ROBOTLASER1" => Some(robot_laser(&mut fields)),
        "FLASER" => Some(front_laser(&mut fields)),
        _ => Some(Err(SkipReason::OtherMessage)),
    }
}

/// laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
/// n r₁…rₙ m remission₁…remissionₘ laser_x laser_y laser_theta robot_x robot_y robot_theta
/// laser_tv laser_rv forward_safety side_safety turn_axis timestamp host logger_timestamp
fn robot_laser(fields: &mut Fields<'_>) -> Result<Line, SkipReason> {
    let _laser_type = fields.number()?;
    let angle_min_rad = fields.number()?;
    let _field_of_view = fields.number()?;
    let angle_increment_rad = fields.number()?;
    let range_max_m = fields.number()?;
    let _accuracy = fields.number()?;
    let _remission_mode = fields.number()?;
    let beams = fields.count()?;
    let ranges_m = fields.ranges(beams, range_max_m)?;
    let remissions = fields.count()?;
    fields.skip(remissions)?;
    let poses = fields.poses()?;
    fields.skip(5)?;
    let lidar = Lidar {
        angle_min_rad,
        angle_increment_rad,
        range_min_m: RANGE_MIN_M,
        range_max_m,
        mount: poses.base_from_lidar,
        range_sigma_m: RANGE_SIGMA_DEFAULT_M,
        band: None,
    };
    line(Message::RobotLaser, lidar, &poses, ranges_m, fields)
}

/// n r₁…rₙ laser_x laser_y laser_theta robot_x robot_y robot_theta timestamp host logger_timestamp
fn front_laser(fields: &mut Fields<'_>) -> Result<Line, SkipReason> {
    let beams = fields.count()?;
    // Half a turn with both ends, or without the last.
    let intervals = match beams {
        180 | 181 => 180.0,
        360 | 361 => 360.0,
        _ => return Err(SkipReason::BeamCount),
    };
    let ranges_m = fields.ranges(beams, FLASER_RANGE_MAX_M)?;
    let poses = fields.poses()?;
    let lidar = Lidar {
        angle_min_rad: -FRAC_PI_2,
        angle_increment_rad: PI / intervals,
        range_min_m: RANGE_MIN_M,
        range_max_m: FLASER_RANGE_MAX_M,
        mount: poses.base_from_lidar,
        range_sigma_m: RANGE_SIGMA_DEFAULT_M,
        band: None,
    };
    line(Message::FrontLaser, lidar, &poses, ranges_m, fields)
}

fn line(
    message: Message,
    lidar: Lidar,
    poses: &Poses,
    ranges_m: Vec<Option<f64>>,
    fields: &mut Fields<'_>,
) -> Result<Line, SkipReason> {
    Ok(Line {
        message,
        lidar,
        odom_from_base: poses.odom_from_base,
        time_s: fields.time_s()?,
        ranges_m,
    })
}

struct Poses {
    odom_from_base: Pose2,
    base_from_lidar: Pose2,
}

struct Fields<'a>(SplitAsciiWhitespace<'a>);

impl Fields<'_> {
    fn number(&mut self) -> Result<f64, SkipReason> {
        let word = self.0.next().ok_or(SkipReason::Truncated)?;
        let number: f64 = word.parse().map_err(|_| SkipReason::NotANumber)?;
        if number.is_finite() {
            Ok(number)
        } else {
            Err(SkipReason::NotANumber)
        }
    }

    fn count(&mut self) -> Result<usize, SkipReason> {
        let word = self.0.next().ok_or(SkipReason::Truncated)?;
        let count = word.parse().map_err(|_| SkipReason::NotANumber)?;
        if count <= BEAMS_MAX {
            Ok(count)
        } else {
            Err(SkipReason::BeamCount)
        }
    }

    fn skip(&mut self, count: usize) -> Result<(), SkipReason> {
        (0..count).try_for_each(|_| self.0.next().map(|_| ()).ok_or(SkipReason::Truncated))
    }

    /// Ranges of the maximum or more are no returns; those too short, negative or not a number are invalid, and
    /// kept as 0.
    fn ranges(&mut self, count: usize, max_m: f64) -> Result<Vec<Option<f64>>, SkipReason> {
        if count == 0 {
            return Err(SkipReason::BeamCount);
        }
        let mut ranges_m = Vec::with_capacity(count);
        for _ in 0..count {
            let word = self.0.next().ok_or(SkipReason::Truncated)?;
            let range_m: f64 = word.parse().map_err(|_| SkipReason::NotANumber)?;
            ranges_m.push(match range_m {
                r if r >= max_m => None,
                r if r >= RANGE_MIN_M => Some(r),
                _ => Some(0.0),
            });
        }
        Ok(ranges_m)
    }

    fn poses(&mut self) -> Result<Poses, SkipReason> {
        let odom_from_lidar = self.pose()?;
        let odom_from_base = self.pose()?;
        Ok(Poses {
            odom_from_base,
            base_from_lidar: odom_from_base.between(&odom_from_lidar),
        })
    }

    fn pose(&mut self) -> Result<Pose2, SkipReason> {
        let (x, y, theta) = (self.number()?, self.number()?, self.number()?);
        let believable = [x, y, theta].iter().all(|v| v.abs() <= POSITION_MAX_M);
        if believable {
            Ok(Pose2::new(x, y, theta))
        } else {
            Err(SkipReason::NotANumber)
        }
    }

    /// The message's own time, or the logger's where that is zero.
    fn time_s(&mut self) -> Result<f64, SkipReason> {
        let own = self.number()?;
        let logger = if self.0.next().is_some() {
            self.number().ok()
        } else {
            None
        };
        let time_s = if own > 0.0 {
            own
        } else {
            logger.unwrap_or(own)
        };
        if (0.0..STAMP_MAX_S).contains(&time_s) {
            Ok(time_s)
        } else {
            Err(SkipReason::NotANumber)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ROBOT_LASER: &str = "ROBOTLASER1 0 -0.2 0.4 0.1 5.60 0.01 0 5 1.5 0.019 5.6 nan 2.25 \
        2 17 18 1.145 2.0 0.0 1.0 2.0 0.0 0 0 0 0 0 212.5 host 999.0";

    fn parse(line: &str) -> Result<Line, SkipReason> {
        parse_line(line).unwrap()
    }

    #[test]
    fn a_robot_laser_line() {
        let line = parse(ROBOT_LASER).unwrap();
        assert_eq!(line.message, Message::RobotLaser);
        assert_eq!(
            line.ranges_m,
            [Some(1.5), Some(0.0), None, Some(0.0), Some(2.25)],
            "the largest range is no return, error codes and NaN say nothing"
        );
        assert_eq!(line.odom_from_base, Pose2::new(1.0, 2.0, 0.0));
        assert!((line.lidar.mount.x - 0.145).abs() < 1e-12);
        assert_eq!(line.lidar.angle_min_rad, -0.2);
        assert_eq!(line.lidar.angle_increment_rad, 0.1);
        assert_eq!(line.lidar.range_max_m, 5.6);
        assert_eq!(line.time_s, 212.5);
    }

    #[test]
    fn the_mount_turns_with_the_robot() {
        // The laser sits 0.2 m ahead and 0.1 m to the left, turned by 0.3, while the robot
        // looks along +y.
        let turned =
            "ROBOTLASER1 0 0 0 0.1 5 0 0 1 1 0 4.9 7.2 1.870796 5 7 1.570796 0 0 0 0 0 1 h 1";
        let mount = parse(turned).unwrap().lidar.mount;
        assert!((mount.x - 0.2).abs() < 1e-5, "{mount:?}");
        assert!((mount.y - 0.1).abs() < 1e-5, "{mount:?}");
        assert!((mount.theta - 0.3).abs() < 1e-5, "{mount:?}");
    }

    fn front_laser_line(beams: usize, tail: &str) -> String {
        let ranges = vec!["2.5"; beams - 1].join(" ");
        format!("FLASER {beams} {ranges} 81.91 {tail}")
    }

    #[test]
    fn front_laser_lines() {
        for (beams, increment_deg) in [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)] {
            let text = front_laser_line(beams, "1 2 0.5 1 2 0.5 976052857.5 nohost 0.36");
            let line = parse(&text).unwrap();
            assert_eq!(line.message, Message::FrontLaser);
            assert_eq!(line.lidar.angle_min_rad, -FRAC_PI_2);
            let increment: f64 = increment_deg;
            assert!((line.lidar.angle_increment_rad - increment.to_radians()).abs() < 1e-15);
            assert_eq!(line.ranges_m.len(), beams);
            assert_eq!(line.ranges_m[0], Some(2.5));
            assert_eq!(line.ranges_m[beams - 1], None);
            assert_eq!(line.time_s, 976_052_857.5);
        }
        let odd = front_laser_line(90, "1 2 0.5 1 2 0.5 1 h 1");
        assert_eq!(parse(&odd), Err(SkipReason::BeamCount));
    }

    #[test]
    fn the_loggers_time_stands_in_for_a_missing_one() {
        let time = |tail: &str| parse(&front_laser_line(180, tail)).map(|l| l.time_s);
        assert_eq!(time("0 0 0 0 0 0 0.0 host 12.5"), Ok(12.5));
        assert_eq!(time("0 0 0 0 0 0 3.5"), Ok(3.5));
        assert_eq!(time("0 0 0 0 0 0 0 host 0"), Ok(0.0));
        assert_eq!(time("0 0 0 0 0 0"), Err(SkipReason::Truncated));
        assert_eq!(time("0 0 0 0 0 0 1e12 host 1"), Err(SkipReason::NotANumber));
    }

    #[test]
    fn every_truncation_is_seen() {
        let words: Vec<&str> = ROBOT_LASER.split_ascii_whitespace().collect();
        let needed = words.len() - 2;
        for kept in 1..needed {
            let cut = words[..kept].join(" ");
            assert_eq!(parse(&cut), Err(SkipReason::Truncated), "{kept} words");
        }
        assert!(parse(&words[..needed].join(" ")).is_ok());
    }

    #[test]
    fn what_is_no_scan_is_named() {
        assert_eq!(parse_line(""), None);
        assert_eq!(parse_line("# a comment"), None);
        assert_eq!(
            parse("ODOM 0 0 0 0 0 0 1 h 1"),
            Err(SkipReason::OtherMessage)
        );
        let spoiled = |from: &str, to: &str| parse(&ROBOT_LASER.replace(from, to)).unwrap_err();
        assert_eq!(spoiled(" 5 1.5", " 5 abc"), SkipReason::NotANumber);
        assert_eq!(spoiled(" 5 1.5", " -5 1.5"), SkipReason::NotANumber);
        assert_eq!(spoiled(" 5 1.5", " 99999999999 1.5"), SkipReason::BeamCount);
        assert_eq!(spoiled(" 5 1.5", " 6 1.5"), SkipReason::Truncated);
        assert_eq!(spoiled("1.145", "inf"), SkipReason::NotANumber);
        assert_eq!(spoiled("1.145", "1e300"), SkipReason::NotANumber);
    }

    proptest! {
        #[test]
        fn no_line_is_fatal(text in ".{0,200}", numbers in prop::collection::vec(any::<f64>(), 0..40)) {
            let _ = parse_line(&text);
            let tail: Vec<String> = numbers.iter().map(f64::to_string).collect();
            for word in ["FLASER", "ROBOTLASER1"] {
                let _ = parse_line(&format!("{word} {text}"));
                let _ = parse_line(&format!("{word} {}", tail.join(" ")));
            }
        }
    }
}
