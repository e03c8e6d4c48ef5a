//! Alerts and decisions through the store, with findings made by hand.

mod accepting;
mod archiving;
mod bench;
mod clocks;
mod corrections;
mod deciding;
mod deleted;
mod edges;
mod folding;
mod memory;
mod preview;
mod rebuilding;
mod several;
