use super::*;
use crate::change::ChangeKind;
use crate::change::JudgedBeam;
use crate::change::series::{ClosureSample, SeriesEntry, SeriesParams, residual_series};
use crate::geometry::{Pose2, Vector2};
use crate::ids::EdgeId;

/// A wall ahead, and a box before it that only the new scan has.
fn beams(new: bool) -> Vec<JudgedBeam> {
    let beam = |k: i32| {
        let (x, on_box) = (0.25 * f64::from(k), (12..=15).contains(&k));
        let (end, verdict) = match (new && on_box, on_box) {
            (true, _) => (Vector2::new(x, 3.2), BeamVerdict::Contradicts),
            (_, true) => (Vector2::new(x, 4.0), BeamVerdict::Occluded),
            _ => (Vector2::new(x, 4.0), BeamVerdict::Agrees),
        };
        match k {
            20 => JudgedBeam {
                end: None,
                verdict: BeamVerdict::NoReturn,
            },
            _ => JudgedBeam {
                end: Some(end),
                verdict,
            },
        }
    };
    (0..24).map(beam).collect()
}

fn entries(delta_f: &[f64]) -> (Vec<SeriesEntry>, Option<f64>) {
    let sample = |(k, &delta_f)| ClosureSample {
        edge_id: EdgeId(870 + k as i64),
        delta_f,
    };
    let samples: Vec<_> = delta_f.iter().enumerate().map(sample).collect();
    let params = SeriesParams {
        closures_min: 2,
        convergence: crate::change::series::ConvergenceRule::Relative(1.0),
        convergence_hold: 1,
        ..SeriesParams::default()
    };
    let series = residual_series(&samples, &params);
    (series.entries, series.threshold)
}

fn with_picture<T>(delta_f: &[f64], read: impl Fn(&EvidencePicture<'_>) -> T) -> T {
    let (old, new) = (beams(false), beams(true));
    let (entries, threshold) = entries(delta_f);
    let region = [
        Vector2::new(2.9, 3.1),
        Vector2::new(3.85, 3.1),
        Vector2::new(3.85, 3.35),
        Vector2::new(2.9, 3.35),
    ];
    let scan = |caption, x, theta, beams| EvidenceScan {
        caption,
        map_from_base: Pose2::new(x, 1.0, theta),
        beams,
    };
    read(&EvidencePicture {
        kind: ChangeKind::Appeared,
        route: "line-4",
        status: "open",
        location: Vector2::new(3.375, 3.2),
        sigma_m: 0.06,
        region: &region,
        laps: 2,
        views: 9,
        confidence: 0.998,
        scans: Some([
            scan("agv-01, trip-1", 2.0, std::f64::consts::FRAC_PI_2, &old),
            scan("agv-07, trip-9 <late>", 4.0, 1.2, &new),
        ]),
        tied: None,
        curve: Some(Curve {
            entries: &entries,
            threshold,
            edge: EdgeId(881),
        }),
    })
}

const RESIDUALS: [f64; 14] = [
    0.0004, 0.0006, 0.0003, 0.0005, 0.0004, 0.0002, 0.0007, 0.0, 0.0004, 0.0005, 0.009, 0.031,
    0.012, 0.0006,
];

#[test]
fn a_picture_is_the_same_bytes_each_time() {
    let svg = with_picture(&RESIDUALS, to_svg);
    assert_eq!(svg, with_picture(&RESIDUALS, to_svg));
    insta::assert_snapshot!("appeared", svg);
}

#[test]
fn every_element_is_closed_and_nothing_leads_outside() {
    let svg = with_picture(&RESIDUALS, to_svg);
    let mut open = Vec::new();
    for tag in svg.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').unwrap();
        match (tag.strip_prefix('/'), tag.ends_with('/')) {
            (Some(name), _) => assert_eq!(open.pop(), Some(name)),
            (None, true) => {}
            (None, false) => open.push(tag.split(' ').next().unwrap()),
        }
    }
    assert!(open.is_empty(), "{open:?}");
    for outside in [
        "script", "href", "http://", "style=", "NaN", "inf", "-0.0\"",
    ] {
        let namespace = "xmlns=\"http://www.w3.org/2000/svg\"";
        assert!(!svg.replace(namespace, "").contains(outside), "{outside}");
    }
    assert!(svg.contains("trip-9 &lt;late&gt;; 4 of 23 points contradicted"));
}

#[test]
fn up_in_the_map_is_up_in_the_picture() {
    let y_of = |at: Vector2<f64>| {
        with_picture(&RESIDUALS, |picture| {
            let mut svg = String::new();
            let place = Panel::around(picture);
            place.draw_location(&mut svg, &at, 0.1);
            let (_, after) = svg.split_once("cy=\"").unwrap();
            after.split_once('"').unwrap().0.parse::<f64>().unwrap()
        })
    };
    let (low, high) = (y_of(Vector2::new(3.0, 2.0)), y_of(Vector2::new(3.0, 3.0)));
    assert!(high < low - 20.0, "{high} {low}");
}

#[test]
fn the_axis_is_logarithmic_where_values_span_decades() {
    let wide = with_picture(&RESIDUALS, to_svg);
    assert!(wide.contains("10⁻²") && wide.contains("10⁻⁴"));
    let narrow = with_picture(
        &[0.4, 0.5, 0.6, 0.5, 0.4, 0.5, 0.6, 0.5, 0.4, 0.5, 0.5, 0.9],
        to_svg,
    );
    assert!(!narrow.contains("10⁻"));
    assert!(narrow.contains("edge 881: ΔF 0.900"));
}

#[test]
fn what_is_missing_is_said() {
    let svg = with_picture(&[], |picture| {
        to_svg(&EvidencePicture {
            scans: None,
            tied: None,
            curve: None,
            region: &[],
            ..picture.clone()
        })
    });
    assert!(svg.contains("There are no scans to compare."));
    let tied = with_picture(&[], |picture| {
        to_svg(&EvidencePicture {
            scans: None,
            tied: Some([Pose2::new(3.0, 3.0, 0.0), Pose2::new(3.5, 3.4, 1.0)]),
            curve: None,
            region: &[],
            ..picture.clone()
        })
    });
    // In each of the two panels.
    assert_eq!(
        tied.matches("<line").count(),
        svg.matches("<line").count() + 2
    );
    assert!(svg.contains("No loop closure carries this alert."));
    assert!(!svg.contains("NaN") && !svg.contains("inf\""));
}

#[test]
fn numbers_are_written_short() {
    for (value, expected) in [
        (0.0, "0"),
        (0.0312, "0.0312"),
        (14.09, "14.1"),
        (0.00022, "2.20e-4"),
        (12_345.0, "1.23e4"),
    ] {
        assert_eq!(text::short(value), expected);
    }
    assert_eq!(text::power_of_ten(-12), "10⁻¹²");
    assert_eq!(text::px(-0.04), "0.0");
    assert_eq!(
        text::escaped("a<b & \"c\"\0"),
        "a&lt;b &amp; &quot;c&quot;\u{fffd}"
    );
}
