//! Measured motions between two poses: their errors, derivatives and contributions to H, one at a
//! time or eight side by side.
//!
//! Poses are named by their places in a slice. Begin with [`cost_and_gradient`].
//!
//! Must not know where poses and measurements come from (no graph, no ids), nor how the equations
//! they lead to are solved.

mod batch;
mod between;
mod local_error;
mod simd;
mod trigonometry;
mod whitening;

pub(super) use batch::{
    Batch, BlocksOfOne, Motions, append_to_batches, cost_and_gradient, fill_batches,
};
pub(super) use between::Factor;
pub(super) use local_error::{Frame, take_steps};
pub(super) use simd::{LANES, dispatch};
pub(super) use whitening::square_root;
