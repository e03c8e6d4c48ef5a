//! SIMD dispatch: plain loops, compiled for the widest registers that the machine has.

use pulp::{Arch, Simd, WithSimd};

/// How many numbers loops work on at a time.
pub(crate) const LANES: usize = 8;

/// Runs work with the widest registers; a closure that is marked `#[inline(always)]` and whose
/// calls are inlined is compiled once for each width.
///
/// [`Arch::dispatch`] takes closures too, but calls them in a way that is rarely inlined: then the
/// loops are as narrow as everywhere else.
#[inline(always)]
pub(crate) fn dispatch<T>(work: impl FnMut() -> T) -> T {
    Arch::new().dispatch(Work(work))
}

struct Work<F>(F);

impl<T, F: FnMut() -> T> WithSimd for Work<F> {
    type Output = T;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> T {
        (self.0)()
    }
}
