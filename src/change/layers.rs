//! Layers: observations of one height band, which are compared with each other and with no others.

use std::collections::BTreeMap;

use super::{Screen, Screened};
use crate::geometry::Vector2;
use crate::scan::{HeightBand, LaserScan};

/// Observations that are compared with each other: those of one height band, or (`None`) those of
/// all planar lidars.
pub type Layer = Option<HeightBand>;

/// The screens of a map's layers.
#[derive(Default)]
pub struct Layers {
    screens: BTreeMap<Layer, Screen>,
}

impl Layers {
    /// Updates the screens to all observations of a map, each by its layer.
    pub fn update<'a>(&mut self, observations: impl Iterator<Item = Screened<'a>>) {
        // A layer without observations left is updated too.
        let known = self.screens.keys().map(|layer| (*layer, Vec::new()));
        let mut of_layers: BTreeMap<Layer, Vec<Screened<'a>>> = known.collect();
        for screened in observations {
            let of_layer = of_layers.entry(layer_of(screened.scan)).or_default();
            of_layer.push(screened);
        }
        for (layer, observations) in of_layers {
            let screen = self.screens.entry(layer).or_default();
            screen.update(observations.into_iter());
        }
    }

    /// Marks all touched cells as judged.
    pub fn mark_judged(&mut self) {
        self.screens.values_mut().for_each(Screen::mark_judged);
    }

    /// The layers with their screens, the one without a band first.
    pub fn iter(&self) -> impl Iterator<Item = (Layer, &Screen)> {
        self.screens.iter().map(|(layer, screen)| (*layer, screen))
    }

    /// Whether anything was touched in or near a region, in any layer, since the last
    /// [`Layers::mark_judged`].
    pub fn is_touched(&self, region: &[Vector2<f64>]) -> bool {
        let mut screens = self.screens.values();
        screens.any(|screen| screen.is_touched(region))
    }

    /// Approximate size in memory, bytes.
    pub fn size_bytes(&self) -> usize {
        self.screens.values().map(Screen::size_bytes).sum()
    }
}

/// The layer that a scan is of.
pub fn layer_of(scan: &LaserScan) -> Layer {
    scan.lidar().height_band()
}
