//! Equations (3), (4), (6), (7) and (10) of the paper: shares of the joints in each task axis.

use pliant_core::params::Projector;

use super::law::{diagonal, inverse, largest};
use super::{Matrix, Oracle, Vector};

/// Computes pseudo-inverse, projector, responsibility and activation of task rows.
pub(super) struct Shares<'a> {
    pub(super) oracle: &'a Oracle,
    pub(super) rows: &'a Matrix,
    pub(super) scaled: &'a Matrix,
    pub(super) row_lambda2: &'a Vector,
    pub(super) sigma: [f64; 2],
}

impl Shares<'_> {
    /// Returns the diagonal matrix D of the inverse joint weights.
    fn joint_weight(&self) -> Matrix {
        let n = self.rows.ncols();
        let weights = self.oracle.settings.paper_options.joint_weights.as_ref();
        diagonal(&Vector::from_fn(n, |i, _| weights.map_or(1.0, |w| 1.0 / w[i])))
    }

    /// Returns the pseudo-inverse `J⁺ = D Jᵀ (J D Jᵀ + λ²)⁻¹`, equation (3) of the paper.
    pub(super) fn pseudo_inverse(&self) -> Matrix {
        let (j, d) = (self.rows, self.joint_weight());
        &d * j.transpose() * inverse(&(j * &d * j.transpose() + diagonal(self.row_lambda2)))
    }

    pub(super) fn projector(&self) -> Matrix {
        let (k, n) = self.rows.shape();
        if k > n {
            return Matrix::zeros(n, n);
        }
        let d = self.joint_weight();
        match self.oracle.settings.null_space.projector {
            Projector::Paper => Matrix::identity(n, n) - self.pseudo_inverse() * self.rows,
            Projector::Exact => {
                let j = self.scaled;
                let mu_1 = 1e-3 * self.sigma[1];
                let mu = mu_1 * (2.0 - self.sigma[0] / mu_1).clamp(0.0, 1.0);
                let gram = j * &d * j.transpose() + Matrix::identity(k, k) * (mu * mu);
                Matrix::identity(n, n) - &d * j.transpose() * inverse(&gram) * j
            }
        }
    }

    /// Returns the responsibility: the columns `|J⁺ diag(Δx)|`, then `|α N∇g|`; equations (6), (7) of the paper.
    pub(super) fn responsibility(&self, dx: &Vector, gradient: &Vector) -> Matrix {
        let settings = &self.oracle.settings;
        let alpha = settings.null_space.gain.unwrap_or_else(|| largest(settings));
        let task = (self.pseudo_inverse() * diagonal(dx)).abs();
        let null = (self.projector() * gradient * alpha).abs();
        let k = task.ncols();
        let mut out = task.resize_horizontally(k + 1, 0.0);
        out.set_column(k, &null);
        out
    }

    /// Returns the activation, equation (10) of the paper, in which Δx cancels; the last column is the null space.
    pub(super) fn activation(&self, gradient: &Vector) -> Matrix {
        let (k, n) = self.rows.shape();
        let pinv = self.pseudo_inverse().abs();
        let share = |v: Vector| if v.sum() > 0.0 { &v / v.sum() } else { v };
        let mut out = Matrix::zeros(n, k + 1);
        (0..k).for_each(|j| out.set_column(j, &share(pinv.column(j).into_owned())));
        if k < n {
            let projector = self.projector();
            let motion = (&projector * gradient).abs();
            let norms = Vector::from_fn(n, |i, _| projector.row(i).norm());
            let blend = (motion.sum() / 1e-3 - 1.0).clamp(0.0, 1.0);
            out.set_column(k, &(share(motion) * blend + share(norms) * (1.0 - blend)));
        }
        out
    }
}
