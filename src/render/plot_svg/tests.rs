//! The drawing of charts.

use super::*;

fn chart() -> Plot {
    Plot {
        title: "F & f".into(),
        x_label: "closures n".into(),
        y_label: "F(n), m²".into(),
        curves: vec![
            Curve {
                label: "unchanged".into(),
                colour: "#1f77b4",
                joined: true,
                points: vec![(0.0, 0.0), (5.0, 1.0), (10.0, f64::NAN), (20.0, 4.0)],
            },
            Curve {
                label: String::new(),
                colour: "#ff7f0e",
                joined: false,
                points: vec![(10.0, 2.0)],
            },
        ],
        guides: vec![
            Guide {
                label: "th".into(),
                at: Crossing::Y(3.0),
            },
            Guide {
                label: "change".into(),
                at: Crossing::X(12.0),
            },
        ],
    }
}

#[test]
fn a_chart_is_drawn_as_it_was() {
    assert_eq!(to_svg(&[chart()]), include_str!("golden.svg"));
}

#[test]
fn charts_stand_one_below_the_other() {
    let two = to_svg(&[chart(), chart()]);
    assert!(two.contains("viewBox=\"0 0 760 500\""));
    assert_eq!(two.matches("<polyline").count(), 2);
    assert_eq!(two.matches("F &amp; f").count(), 2);
}

#[test]
fn ticks_are_round_and_within() {
    for (low, high) in [(0.0, 1.0), (-3.0, 17.0), (1e-5, 7e-5), (0.0, 12_345.0)] {
        let axis = Axis::new([low, high].into_iter(), 0.0, 100.0);
        let ticks = axis.ticks();
        assert!((2..=8).contains(&ticks.len()), "{ticks:?}");
        let slack = 1e-9 * (high - low);
        assert!(
            ticks
                .iter()
                .all(|t| (low - slack..=high + slack).contains(t))
        );
    }
}

#[test]
fn nothing_and_one_value_make_an_axis() {
    let empty = Plot {
        curves: Vec::new(),
        guides: Vec::new(),
        ..chart()
    };
    assert!(!to_svg(&[empty]).contains("NaN"));
    let axis = Axis::new([2.0].into_iter(), 0.0, 100.0);
    assert_eq!(axis.place(2.0), 50.0);
}

#[test]
fn numbers_are_short() {
    let cases = [
        (0.0, "0"),
        (20.0, "20"),
        (0.25, "0.25"),
        (-1.5, "-1.5"),
        (2e-5, "2e-5"),
        (2.5e-5, "2.5e-5"),
        (1e6, "1e6"),
    ];
    for (value, text) in cases {
        assert_eq!(number(value), text);
    }
}
