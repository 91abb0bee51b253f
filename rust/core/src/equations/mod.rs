//! The paper's equations as functions, for Jacobians from other libraries.
//!
//! Matrices are those of nalgebra: `J` is k × n with at most six rows, one per task axis, and at most sixteen columns,
//! one per joint; `J⁺` is n × k. The functions have no state and need no robot model.
//!
//! ```
//! use pliant_core::nalgebra::DMatrix;
//! use pliant_core::{Projector, damped_pseudo_inverse, null_space_projector};
//!
//! # fn main() -> pliant_core::Result<()> {
//! let jacobian = DMatrix::from_row_slice(1, 2, &[3.0, 4.0]); // one axis, two joints
//! let inverse = damped_pseudo_inverse(&jacobian, 0.0)?;
//! let projector = null_space_projector(&jacobian, 0.0, Projector::Exact)?;
//! assert!(((&jacobian * inverse)[(0, 0)] - 1.0).abs() < 1e-12);
//! assert!((&jacobian * projector).norm() < 1e-12, "no motion of the null space moves the axis");
//! # Ok(())
//! # }
//! ```

mod arguments;

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result};
use crate::law::activation::Activation;
use crate::law::nullspace::projector_damping_sq;
use crate::law::{activation, nullspace};
use crate::math::rows::load_rows;
use crate::math::simd::{F64x8, JointVec16, JointVector, RealOps};
use crate::math::svd::Svd;
use crate::params::Projector;
use crate::pose::Pose;
use crate::task::{adapt, compliance as task_compliance};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, task};

use arguments::{array, check, finite, inverse_rows, product, same_length, square, task_rows, without_overflow};

/// Computes the damped pseudo-inverse `J⁺ = Jᵀ (J Jᵀ + λ²I)⁻¹`, n × k; equation (3) of the paper.
///
/// `damping` is λ, not λ². λ = 0 gives the Moore–Penrose inverse, also of a rank-deficient matrix.
///
/// # Errors
/// [`Error::Shape`] above six rows or sixteen columns, [`Error::OutOfRange`] for an entry that is not finite or λ < 0,
/// [`Error::Config`] if the result overflows.
pub fn damped_pseudo_inverse(jacobian: &DMatrix<f64>, damping: f64) -> Result<DMatrix<f64>> {
    let (_, k, n) = task_rows("J", jacobian)?;
    check("damping", damping, damping >= 0.0 && damping.is_finite(), "[0, ∞)")?;
    let squared = damping * damping;
    // By SVD: if J is singular or has more axes than joints, a small λ² would be lost to rounding in J Jᵀ + λ²I.
    let svd = svd(jacobian)?;
    let cutoff = f64::EPSILON * k.max(n) as f64 * svd.sigma.max();
    let gains = svd.sigma.map(|s| if s > cutoff { s / (s * s + squared) } else { 0.0 });
    let scaled = DMatrix::from_fn(n, gains.len(), |i, s| svd.v[(i, s)] * gains[s]);
    without_overflow("J", product(&scaled, &svd.u.transpose()))
}

/// Computes the null-space projector of `J`, n × n.
///
/// `Exact` is the orthogonal projector `I − Jᵀ (J Jᵀ + μ²I)⁻¹ J`. μ is 0 except near a singular `J`, where the
/// projector would jump and μ fades it; `damping` is checked but not used. `Paper` is `I − J⁺J`, equation (4) of the
/// paper, with J⁺ damped by λ = `damping`.
///
/// # Errors
/// As [`damped_pseudo_inverse`].
pub fn null_space_projector(jacobian: &DMatrix<f64>, damping: f64, kind: Projector) -> Result<DMatrix<f64>> {
    let (rows, k, n) = task_rows("J", jacobian)?;
    match kind {
        Projector::Paper => {
            let projected = product(&damped_pseudo_inverse(jacobian, damping)?, jacobian);
            without_overflow("J", DMatrix::identity(n, n) - projected)
        }
        Projector::Exact => {
            check("damping", damping, damping >= 0.0 && damping.is_finite(), "[0, ∞)")?;
            let sigma = svd(jacobian)?.sigma;
            let added = [projector_damping_sq(sigma.min(), sigma.max()); MAX_AXES];
            let matrix = nullspace::projector(&rows, &[1.0; MAX_JOINTS], &added, (k, n));
            without_overflow("J", DMatrix::from_fn(n, n, |i, j| matrix[i][j]))
        }
    }
}

/// Computes the responsibility R, n × (k + 1): the columns of `|J⁺ diag(Δx)|`, then `|α N∇g|`. Equations (6), (7) of
/// the paper, with the task velocity Δx, the gain α of the null-space motion, the projector N and the gradient ∇g.
///
/// # Errors
/// [`Error::Shape`] for inconsistent sizes, [`Error::OutOfRange`] for an entry that is not finite, [`Error::Config`] if
/// the result overflows.
pub fn responsibility(
    pseudo_inverse: &DMatrix<f64>,
    dx: &[f64],
    projector: &DMatrix<f64>,
    gradient: &[f64],
    alpha: f64,
) -> Result<DMatrix<f64>> {
    let (transposed, k, n) = inverse_rows(pseudo_inverse)?;
    let dx: AxisVec = array("dx", dx, k)?;
    let projector = square("N", projector, n)?;
    let gradient: JointVec = array("gradient", gradient, n)?;
    check("alpha", alpha, alpha.is_finite(), "finite")?;
    let motion = activation::product(&projector, &gradient);
    without_overflow("J_pinv", activation::responsibility(&transposed, &dx, &motion, alpha, (k, n)))
}

/// Computes the activation matrix A, n × (k + 1): the columns of `|J⁺|`, each divided by its sum, then the null-space
/// column. Equation (10) of the paper, in which Δx cancels.
///
/// The null-space column is `|N∇g|` divided by its sum. Where `N∇g` vanishes, or without a gradient, it blends into the
/// normalized row norms of `N`. Without redundancy (k ≥ n) it is 0.
///
/// # Errors
/// As [`responsibility`].
pub fn activation(
    pseudo_inverse: &DMatrix<f64>,
    projector: &DMatrix<f64>,
    gradient: Option<&[f64]>,
) -> Result<DMatrix<f64>> {
    let (transposed, k, n) = inverse_rows(pseudo_inverse)?;
    let projector = square("N", projector, n)?;
    let gradient: JointVec = gradient.map_or(Ok([0.0; MAX_JOINTS]), |gradient| array("gradient", gradient, n))?;
    // With at least as many axes as joints, N is only rounding error.
    let null = if k < n {
        let motion = JointVec16::load(&activation::product(&projector, &gradient));
        activation::null_column(motion, &projector)
    } else {
        JointVec16::splat(0.0)
    };
    without_overflow("J_pinv", Activation::new(&load_rows(&transposed), null).matrix(k, n))
}

/// Computes the compliance c, one entry per axis: 1 if the absolute deviation is below `soft_until`, 0 above
/// `firm_from`, linear between. Equation (8) of the paper.
///
/// `deviation`, `soft_until` and `firm_from` are in m, or in rad for rotations; deviations may have any sign.
///
/// # Errors
/// [`Error::Shape`] for lists of different lengths, [`Error::OutOfRange`] unless `0 ≤ soft_until < firm_from`, all
/// finite.
pub fn compliance(deviation: &[f64], soft_until: &[f64], firm_from: &[f64]) -> Result<Vec<f64>> {
    same_length("soft_until", soft_until.len(), deviation.len())?;
    same_length("firm_from", firm_from.len(), deviation.len())?;
    let triples = deviation.iter().zip(soft_until).zip(firm_from).enumerate();
    triples
        .map(|(i, ((&d, &low), &high))| {
            check(format!("deviation[{i}]"), d, d.is_finite(), "finite")?;
            check(format!("firm_from[{i}]"), high, high > 0.0 && high.is_finite(), "(soft_until, ∞)")?;
            check(format!("soft_until[{i}]"), low, low >= 0.0 && low < high, &format!("[0, firm_from = {high})"))?;
            Ok(task_compliance::compliance(d, low, high))
        })
        .collect()
}

/// Computes the holding torque τ^x, one entry per axis: `c soft + (1 − c) firm` if the axis is compliant, else `hold`.
/// Equation (9) of the paper.
///
/// Unlike the settings of a controller, it does not require soft ≤ firm ≤ hold.
///
/// # Errors
/// [`Error::Shape`] for lists of different lengths, [`Error::OutOfRange`] for c outside [0, 1] or a strength not
/// finite.
pub fn holding_torque(c: &[f64], soft: &[f64], firm: &[f64], hold: &[f64], compliant: &[bool]) -> Result<Vec<f64>> {
    let lengths = [("soft", soft.len()), ("firm", firm.len()), ("hold", hold.len()), ("compliant", compliant.len())];
    for (name, length) in lengths {
        same_length(name, length, c.len())?;
    }
    (0..c.len())
        .map(|i| {
            check(format!("c[{i}]"), c[i], (0.0..=1.0).contains(&c[i]), "[0, 1]")?;
            for (name, value) in [("soft", soft[i]), ("firm", firm[i]), ("hold", hold[i])] {
                check(format!("{name}[{i}]"), value, value.is_finite(), "finite")?;
            }
            Ok(task_compliance::holding_torque(c[i], soft[i], firm[i], hold[i], compliant[i]))
        })
        .collect()
}

/// Computes the joint torque limits `τ^q = A τ^x` [N·m], equation (11) of the paper. `strength` is τ^x [N·m], one entry
/// per column of A, the null space last.
///
/// # Errors
/// [`Error::Shape`] for inconsistent sizes, [`Error::OutOfRange`] for an entry that is not finite, [`Error::Config`] if
/// the result overflows.
pub fn joint_torque_limits(activation: &DMatrix<f64>, strength: &[f64]) -> Result<DVector<f64>> {
    let (n, columns) = activation.shape();
    if columns == 0 || columns > MAX_AXES + 1 || n == 0 || n > MAX_JOINTS {
        let expected = format!("(1 to {MAX_JOINTS} joints, 1 to {} columns)", MAX_AXES + 1);
        return Err(Error::Shape { what: "A".into(), got: format!("({n}, {columns})"), expected });
    }
    finite("A", activation)?;
    let k = columns - 1;
    let all: [f64; MAX_AXES + 1] = array("strength", strength, columns)?;
    let (mut task, mut null) = ([[0.0; MAX_JOINTS]; MAX_AXES], [0.0; MAX_JOINTS]);
    let mut budgets = [0.0; MAX_AXES];
    budgets[..k].copy_from_slice(&all[..k]);
    for i in 0..n {
        (0..k).for_each(|r| task[r][i] = activation[(i, r)]);
        null[i] = activation[(i, k)];
    }
    let torque = Activation::of(&task, &null).distribute(F64x8::from_axes(&budgets), all[k]);
    let limits = DMatrix::from_column_slice(n, 1, &torque.to_joints()[..n]);
    Ok(DVector::from_column_slice(without_overflow("A", limits)?.as_slice()))
}

/// Computes the intermediate target, equation (12) of the paper: `x_d + η (x − x_d)` on the compliant base axes (x, y,
/// z, roll, pitch, yaw), `x_d` on the others.
///
/// # Errors
/// As [`Pose::validate`]; [`Error::OutOfRange`] for η outside [0, 1].
pub fn adapt_target(actual: &Pose, target: &Pose, eta: f64, compliant: [bool; MAX_AXES]) -> Result<Pose> {
    actual.validate()?;
    target.validate()?;
    check("eta", eta, (0.0..=1.0).contains(&eta), "[0, 1]")?;
    Ok(adapt::adapt_target(actual, target, eta, compliant))
}

/// Computes the deviation `e = x_d − x` in base axes [m, rad]: difference of the positions, then rotation vector of
/// `R_d Rᵀ`.
///
/// # Errors
/// As [`Pose::validate`].
pub fn pose_error(actual: &Pose, target: &Pose) -> Result<AxisVec> {
    actual.validate()?;
    target.validate()?;
    Ok(task::pose_error(actual, target))
}

fn svd(m: &DMatrix<f64>) -> Result<Svd> {
    Svd::new(m).ok_or_else(|| Error::config("J", "its singular values could not be found"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jacobian(k: usize, n: usize) -> DMatrix<f64> {
        DMatrix::from_fn(k, n, |r, i| (((r * n + i) as f64).powi(2) * 0.7).sin())
    }

    #[test]
    fn without_damping_it_is_the_moore_penrose_inverse_at_every_shape_and_rank() {
        let mut deficient = jacobian(6, 7);
        let copy = deficient.row(1).into_owned() * 2.0;
        deficient.set_row(4, &copy);
        for j in [jacobian(6, 7), jacobian(3, 7), jacobian(6, 5), jacobian(6, 16), deficient, DMatrix::zeros(6, 7)] {
            let p = damped_pseudo_inverse(&j, 0.0).unwrap();
            let (jp, pj) = (&j * &p, &p * &j);
            for (a, b) in [(&jp * &j, j.clone()), (&p * &jp, p.clone()), (jp.transpose(), jp), (pj.transpose(), pj)] {
                assert!((a - b).amax() < 1e-10);
            }
        }
    }

    #[test]
    fn a_small_damping_is_exact_with_fewer_joints_than_axes() {
        // J Jᵀ + λ²I, 6 × 6, has five eigenvalues λ²: solving with it would lose digits. Jᵀ J + λ²I is 1 × 1.
        let j = jacobian(6, 1);
        for damping in [1e-7, 1e-5, 1e-4, 1e-3, 1e-2, 0.1] {
            let exact = j.transpose() / (j.norm_squared() + damping * damping);
            let got = damped_pseudo_inverse(&j, damping).unwrap();
            assert!((got - &exact).amax() < 1e-13 * exact.amax(), "{damping}");
        }
        assert!(damped_pseudo_inverse(&DMatrix::zeros(6, 7), 0.1).unwrap().amax() < f64::MIN_POSITIVE);
    }

    #[test]
    fn the_exact_projector_annihilates_the_task_and_is_idempotent() {
        let j = jacobian(4, 7);
        let n = null_space_projector(&j, 0.1, Projector::Exact).unwrap();
        assert!((&j * &n).amax() < 1e-12 && (&n * &n - &n).amax() < 1e-12);
        let damped = null_space_projector(&j, 0.1, Projector::Paper).unwrap();
        assert!((&j * damped).amax() > 1e-4);
    }

    #[test]
    fn columns_of_the_activation_sum_to_one() {
        let j = jacobian(4, 7);
        let p = damped_pseudo_inverse(&j, 0.02).unwrap();
        let n = null_space_projector(&j, 0.0, Projector::Exact).unwrap();
        for gradient in [None, Some(&[1.0; 7][..]), Some(&[0.0; 7][..])] {
            let a = activation(&p, &n, gradient).unwrap();
            assert!(a.column_iter().all(|column| (column.sum() - 1.0).abs() < 1e-12));
        }
        let r = responsibility(&p, &[0.1; 4], &n, &[1.0; 7], 0.5).unwrap();
        let a = activation(&p, &n, Some(&[1.0; 7])).unwrap();
        let limits = joint_torque_limits(&a, &[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert!((limits.sum() - 15.0).abs() < 1e-12);
        assert!((r.column(0) / r.column(0).sum() - a.column(0)).amax() < 1e-12);
    }

    #[test]
    fn without_redundancy_the_null_column_is_zero() {
        let j = jacobian(4, 4);
        let n = null_space_projector(&j, 0.0, Projector::Exact).unwrap();
        let a = activation(&damped_pseudo_inverse(&j, 0.0).unwrap(), &n, Some(&[1.0; 4])).unwrap();
        assert!(a.column(4).amax() < f64::MIN_POSITIVE && (a.column(0).sum() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_holding_torque_lies_between_soft_and_firm() {
        let torques = holding_torque(&[0.25, 0.25], &[1.0; 2], &[2.0; 2], &[5.0; 2], &[true, false]).unwrap();
        assert!((torques[0] - 1.75).abs() < 1e-15 && (torques[1] - 5.0).abs() < 1e-15, "{torques:?}");
    }

    #[test]
    fn invalid_arguments_are_named() {
        let message = |result: Result<DMatrix<f64>>| result.unwrap_err().to_string();
        assert_eq!(
            message(damped_pseudo_inverse(&jacobian(7, 7), 0.1)),
            "J has shape (7, 7), expected (1 to 6 axes, 1 to 16 joints)"
        );
        let mut j = jacobian(6, 7);
        j[(2, 3)] = f64::NAN;
        assert_eq!(message(damped_pseudo_inverse(&j, 0.0)), "J[2, 3] = NaN is outside finite");
        assert_eq!(message(damped_pseudo_inverse(&jacobian(6, 7), -0.1)), "damping = -0.1 is outside [0, ∞)");
        assert!(compliance(&[0.0], &[0.1], &[0.1]).unwrap_err().to_string().starts_with("soft_until[0] = 0.1"));
        assert!(holding_torque(&[0.5], &[1.0], &[2.0], &[], &[true]).is_err());
    }
}
