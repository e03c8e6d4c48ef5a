//! Plain loops, compiled for the widest registers that the machine has.

use pulp::{Arch, Simd, WithSimd};

/// Does some work with them; a closure that is marked `#[inline(always)]` and whose calls are
/// inlined is compiled once for each width.
///
/// [`Arch::dispatch`] takes closures too, but calls them in a way that is rarely inlined: then all
/// is as narrow as everywhere else.
#[inline(always)]
pub(super) fn wide<T>(work: impl FnMut() -> T) -> T {
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
