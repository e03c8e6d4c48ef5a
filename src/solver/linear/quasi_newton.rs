//! Quasi-Newton steps with an old factorisation.
//!
//! Limited-memory BFGS (Nocedal 1980) with the factored H as its initial Hessian: each step shows
//! how the gradient changes along it, and the next steps take that into account. So a factor of H
//! at a nearby point, or of H without the latest terms, leads to the optimum in a few steps.

/// How many pairs are kept.
const PAIRS_MAX: usize = 8;

/// The last steps, each paired with the change of the gradient along it, oldest first.
#[derive(Debug, Default)]
pub(crate) struct QuasiNewton {
    pairs: Vec<Pair>,
    /// The step that was taken last, and the gradient before it in place of its change.
    taken: Option<Pair>,
    /// Memory to be used again.
    spare: Vec<Pair>,
}

#[derive(Debug, Default)]
struct Pair {
    step: Vec<f64>,
    change: Vec<f64>,
    curvature: f64,
    /// α of the two-loop recursion: how much of the change was taken out of the gradient.
    alpha: f64,
}

impl QuasiNewton {
    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.spare.append(&mut self.pairs);
        self.spare.extend(self.taken.take());
    }

    /// A step is taken from where the gradient is this.
    pub(crate) fn take(&mut self, step: &[f64], gradient: &[f64]) {
        self.spare.extend(self.taken.take());
        let mut taken = self.spare.pop().unwrap_or_default();
        taken.step.clear();
        taken.step.extend_from_slice(step);
        taken.change.clear();
        taken.change.extend_from_slice(gradient);
        self.taken = Some(taken);
    }

    /// The gradient after the step.
    pub(crate) fn learn(&mut self, gradient: &[f64]) {
        let Some(mut taken) = self.taken.take() else {
            return;
        };
        for (change, new) in taken.change.iter_mut().zip(gradient) {
            *change = new - *change;
        }
        taken.curvature = dot(&taken.step, &taken.change);
        // Along a step without positive curvature the initial Hessian is better.
        if !(taken.curvature.is_finite() && taken.curvature > 0.0) {
            self.spare.push(taken);
            return;
        }
        if self.pairs.len() == PAIRS_MAX {
            self.spare.push(self.pairs.remove(0));
        }
        self.pairs.push(taken);
    }

    /// First loop of the recursion: turns a gradient into the right-hand side to solve the factored
    /// H for; returns the part of the predicted decrease that belongs to what is taken out.
    pub(crate) fn before_solve(&mut self, gradient: &mut [f64]) -> f64 {
        let mut predicted = 0.0;
        for pair in self.pairs.iter_mut().rev() {
            pair.alpha = dot(&pair.step, gradient) / pair.curvature;
            predicted += pair.alpha * pair.alpha * pair.curvature;
            add(gradient, -pair.alpha, &pair.change);
        }
        predicted
    }

    /// Second loop: turns the solution of that into the step.
    pub(crate) fn after_solve(&self, solution: &mut [f64]) {
        for pair in &self.pairs {
            let beta = dot(&pair.change, solution) / pair.curvature;
            add(solution, pair.alpha - beta, &pair.step);
        }
    }
}

fn add(to: &mut [f64], factor: f64, what: &[f64]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += factor * what;
    }
}

/// The scalar product, in eight sums at a time so that they can share vector registers.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
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

    /// The initial Hessian is right in all but two directions of five.
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
        let mut pairs = QuasiNewton::default();
        for _ in 0..8 {
            let here = gradient(&x);
            pairs.learn(&here);
            let mut step: Vec<f64> = here.iter().map(|g| -g).collect();
            pairs.before_solve(&mut step);
            // The initial Hessian is the identity.
            pairs.after_solve(&mut step);
            pairs.take(&step, &here);
            add(&mut x, 1.0, &step);
        }
        assert!(x.iter().all(|x| (x - 2.0).abs() < 1e-9), "{x:?}");
    }
}
