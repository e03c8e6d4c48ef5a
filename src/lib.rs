//! mapshift tells the keepers of a map where the world has changed.
//!
//! Vehicles that drive the same routes again and again upload batches of 2D lidar scans. The
//! service keeps one pose graph per route, matches scans, merges each lap as loop closures,
//! optimises the sub-graph that is touched, and watches the residuals. It implements
//! Rozsa, Golarits, Szirányi, *Localization of map changes by exploiting SLAM residuals*.
//!
//! # Layers
//!
//! A module uses only itself and modules before it in this list; `tests/layers.rs` holds it to
//! that. `docs/explanation/architecture.md` has a line on each.
//!
//! 1. Foundation: [`ids`], [`model`].
//! 2. Core: [`geometry`], [`scan`], [`matching`], [`calibration`], [`observation`], [`graph`],
//!    [`solver`], [`change`], [`mapping`], [`sim`]. Pure, synchronous, deterministic: no tokio, no
//!    axum, no SQL, no files, no environment, no wall clock, no unseeded randomness.
//! 3. Service: [`ingest`], [`render`], [`experiments`], [`store`], [`pipeline`],
//!    [`http_client`], [`webhooks`], [`api`].
//! 4. Process: [`config`], [`telemetry`], [`app`], `client`, [`cli`].
//!
//! # Conventions
//!
//! - Metres, radians, seconds; x forward, y left, counter-clockwise positive (REP-103).
//! - Frames: `map` (a route's), `odom` (a vehicle's own), `base` (the vehicle), `lidar`.
//!   A pose named `map_from_base` takes base coordinates to map coordinates.
//! - A tangent vector of SE(2) is ordered (x, y, θ); information matrices have that order too.
//! - The error of an edge is g2o's:
//!   e = \[R_zᵀ(R_iᵀ(p_j − p_i) − t_z); wrap(θ_j − θ_i − θ_z)\], and the cost is
//!   F = Σ eᵀΩe, without a factor ½ (paper, equation 2).
//! - Names carry their unit last: `range_max_m`, `lease_ms`.

// The example of an alert in the OpenAPI document has more tokens than `json!` takes otherwise.
#![recursion_limit = "256"]

pub mod api;
pub mod app;
pub mod calibration;
pub mod change;
pub mod cli;
mod client;
pub mod config;
pub mod experiments;
pub mod geometry;
pub mod graph;
pub mod http_client;
pub mod ids;
pub mod ingest;
pub mod mapping;
pub mod matching;
pub mod model;
pub mod observation;
pub mod pipeline;
pub mod render;
pub mod scan;
pub mod sim;
pub mod solver;
pub mod store;
pub mod telemetry;
pub mod webhooks;
