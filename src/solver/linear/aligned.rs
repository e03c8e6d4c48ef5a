//! Numbers that begin where a line of the processor's cache does.

/// The length of a line of the cache.
const LINE_BYTES: usize = 64;
const LINE: usize = LINE_BYTES / size_of::<f64>();

/// A slice of numbers that may become longer. Vectors of numbers read from places in it that are
/// multiples of their length lie in one line of the cache each.
#[derive(Debug, Default)]
pub(super) struct Aligned {
    /// The slice begins somewhere in the first line.
    numbers: Vec<f64>,
    first: usize,
    length: usize,
}

impl Aligned {
    pub(super) fn as_slice(&self) -> &[f64] {
        &self.numbers[self.first..self.first + self.length]
    }

    pub(super) fn as_mut_slice(&mut self) -> &mut [f64] {
        &mut self.numbers[self.first..self.first + self.length]
    }

    /// Makes the slice at least this long; what is new is zero.
    pub(super) fn grow(&mut self, length: usize) {
        if length <= self.length {
            return;
        }
        if self.first + length > self.numbers.len() {
            // Room for more where it was not the first time.
            let room = if self.length == 0 {
                length
            } else {
                length.max(2 * self.length)
            };
            let mut numbers = vec![0.0; room + LINE];
            // An address that cannot be had is as good as any: only speed depends on it.
            let first = numbers.as_ptr().align_offset(LINE_BYTES).min(LINE);
            numbers[first..first + self.length].copy_from_slice(self.as_slice());
            (self.numbers, self.first) = (numbers, first);
        }
        self.length = length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_there_stays() {
        let mut numbers = Aligned::default();
        assert!(numbers.as_slice().is_empty());
        for length in [3, 40, 41, 1000, 7] {
            let before = numbers.as_slice().to_vec();
            numbers.grow(length);
            assert_eq!(numbers.as_slice().len(), length.max(before.len()));
            assert_eq!(numbers.as_slice()[..before.len()], before);
            assert!(numbers.as_slice()[before.len()..].iter().all(|&x| x == 0.0));
            assert_eq!(numbers.as_slice().as_ptr() as usize % LINE_BYTES, 0);
            let last = numbers.as_slice().len() - 1;
            numbers.as_mut_slice()[last] = 1.5;
        }
    }
}
