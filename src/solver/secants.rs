//! What steps by an old factorisation have shown of the Hessian since.
//!
//! Limited-memory BFGS (Nocedal 1980) with the factored H as its first guess: each step taken
//! tells how the gradient changed along it, and the next steps take that into account. So a
//! factorisation from nearby poses, or of a graph with a closure less, leads to the optimum in a
//! few steps.

/// So many of the last steps are remembered.
const REMEMBERED: usize = 8;

/// The last steps and how the gradient changed along them, oldest first.
#[derive(Debug, Default)]
pub(super) struct Secants {
    pairs: Vec<Secant>,
    /// The step that was taken last, and the gradient before it in place of its change.
    taken: Option<Secant>,
    /// Memory to be used again.
    spare: Vec<Secant>,
}

#[derive(Debug, Default)]
struct Secant {
    step: Vec<f64>,
    change: Vec<f64>,
    curvature: f64,
    /// The share of the change that was taken out of the gradient.
    share: f64,
}

impl Secants {
    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.spare.append(&mut self.pairs);
        self.spare.extend(self.taken.take());
    }

    /// A step is taken from where the gradient is this.
    pub(super) fn take(&mut self, step: &[f64], gradient: &[f64]) {
        self.spare.extend(self.taken.take());
        let mut taken = self.spare.pop().unwrap_or_default();
        taken.step.clear();
        taken.step.extend_from_slice(step);
        taken.change.clear();
        taken.change.extend_from_slice(gradient);
        self.taken = Some(taken);
    }

    /// The gradient after the step.
    pub(super) fn learn(&mut self, gradient: &[f64]) {
        let Some(mut taken) = self.taken.take() else {
            return;
        };
        for (change, new) in taken.change.iter_mut().zip(gradient) {
            *change = new - *change;
        }
        taken.curvature = dot(&taken.step, &taken.change);
        // Along a step that shows no curvature, the first guess is better.
        if !(taken.curvature.is_finite() && taken.curvature > 0.0) {
            self.spare.push(taken);
            return;
        }
        if self.pairs.len() == REMEMBERED {
            self.spare.push(self.pairs.remove(0));
        }
        self.pairs.push(taken);
    }

    /// What the factored H is to be solved for instead of a gradient; returns the part of the
    /// promised decrease that goes with what is taken out.
    pub(super) fn before_solve(&mut self, gradient: &mut [f64]) -> f64 {
        let mut promise = 0.0;
        for pair in self.pairs.iter_mut().rev() {
            pair.share = dot(&pair.step, gradient) / pair.curvature;
            promise += pair.share * pair.share * pair.curvature;
            add(gradient, -pair.share, &pair.change);
        }
        promise
    }

    /// The step, from what the solve gave.
    pub(super) fn after_solve(&self, solution: &mut [f64]) {
        for pair in &self.pairs {
            let share = dot(&pair.change, solution) / pair.curvature;
            add(solution, pair.share - share, &pair.step);
        }
    }
}

fn add(to: &mut [f64], factor: f64, what: &[f64]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += factor * what;
    }
}

/// Eight sums at a time, so that they can share vector registers.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_chunks.remainder().iter().zip(b_chunks.remainder());
    let rest: f64 = rest.map(|(a, b)| a * b).sum();
    for (a, b) in a_chunks.zip(b_chunks) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first guess is right in all but two directions of five.
    #[test]
    fn few_steps_suffice_for_few_wrong_directions() {
        let curvatures = [1.5, 1.0, 0.75, 1.0, 1.0];
        let gradient = |x: &[f64]| -> Vec<f64> {
            x.iter()
                .zip(curvatures)
                .map(|(x, c)| c * (x - 2.0))
                .collect()
        };
        let mut x = vec![0.0, 5.0, -1.0, 2.5, 9.0];
        let mut secants = Secants::default();
        for _ in 0..8 {
            let here = gradient(&x);
            secants.learn(&here);
            let mut step: Vec<f64> = here.iter().map(|g| -g).collect();
            secants.before_solve(&mut step);
            // The first guess is that every curvature is one.
            secants.after_solve(&mut step);
            secants.take(&step, &here);
            add(&mut x, 1.0, &step);
        }
        assert!(x.iter().all(|x| (x - 2.0).abs() < 1e-9), "{x:?}");
    }
}
