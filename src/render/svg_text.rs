//! Numbers and words of a picture.

/// How words are written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ink {
    size_px: f64,
    colour: &'static str,
    weight: &'static str,
    anchor: &'static str,
    /// Whether a white rim keeps it readable on points.
    rim: bool,
}

impl Ink {
    pub(super) const PLAIN: Self = Self {
        size_px: 13.0,
        colour: "#1c2430",
        weight: "400",
        anchor: "start",
        rim: false,
    };
    pub(super) const LARGE: Self = Self {
        size_px: 16.0,
        ..Self::PLAIN
    };
    pub(super) const QUIET: Self = Self {
        colour: "#5a6472",
        ..Self::PLAIN
    };
    pub(super) const TITLE: Self = Self {
        size_px: 22.0,
        weight: "600",
        ..Self::PLAIN
    };
    pub(super) const HEADING: Self = Self {
        size_px: 14.0,
        weight: "600",
        ..Self::PLAIN
    };
    pub(super) const ON_MAP: Self = Self {
        weight: "600",
        rim: true,
        ..Self::PLAIN
    };
    /// Beside a scale bar: still read when the picture is half as wide.
    pub(super) const SCALE: Self = Self {
        size_px: 20.0,
        ..Self::ON_MAP
    };
    pub(super) const TICK: Self = Self {
        size_px: 11.0,
        ..Self::QUIET
    };
    pub(super) const ALARM: Self = Self {
        colour: "#b3261e",
        weight: "600",
        rim: true,
        ..Self::PLAIN
    };

    pub(super) fn anchored(self, anchor: &'static str) -> Self {
        Self { anchor, ..self }
    }
}

/// Writes words; (x, y) is on their base line.
pub(super) fn label(svg: &mut String, x_px: f64, y_px: f64, words: &str, ink: Ink) {
    let rim = match ink.rim {
        true => {
            " stroke=\"#ffffff\" stroke-width=\"3\" stroke-linejoin=\"round\" paint-order=\"stroke\""
        }
        false => "",
    };
    svg.push_str(&format!(
        "<text x=\"{}\" y=\"{}\" font-size=\"{}\" font-weight=\"{}\" text-anchor=\"{}\" fill=\"{}\"{rim}>{}</text>\n",
        px(x_px),
        px(y_px),
        ink.size_px,
        ink.weight,
        ink.anchor,
        ink.colour,
        escaped(words),
    ));
}

/// A coordinate: one decimal, no negative zero.
pub(super) fn px(value: f64) -> String {
    let rounded = (value * 10.0).round() / 10.0;
    format!("{:.1}", rounded + 0.0)
}

/// Text for XML; what XML cannot hold becomes a replacement character.
pub(super) fn escaped(words: &str) -> String {
    let mut out = String::with_capacity(words.len());
    for c in words.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// A power of ten, as it is written beside an axis.
pub(super) fn power_of_ten(exponent: i32) -> String {
    let raised = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        c => c
            .to_digit(10)
            .and_then(|d| char::from_u32(0x2070 + d))
            .unwrap_or(c),
    };
    match exponent {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        _ => format!(
            "10{}",
            exponent.to_string().chars().map(raised).collect::<String>()
        ),
    }
}

/// A number with three significant digits.
pub(super) fn short(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        "0".to_owned()
    } else if (0.001..1000.0).contains(&size) {
        let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{value:.2e}")
    }
}
