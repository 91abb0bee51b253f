//! The paper's equations with arbitrary matrices: finite results or an error.

use nalgebra::DMatrix;
use pliant_core::{
    Pose, Projector, activation, adapt_target, compliance, damped_pseudo_inverse, holding_torque, joint_torque_limits,
    null_space_projector, pose_error, responsibility,
};

use super::checks::assert_explained;
use super::input::Input;
use super::step::pose;

/// Computes one equation, or several that use each other's results.
pub fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let kind = input.below(4);
    match kind {
        0 => chain(&mut input),
        1 => lists(&mut input),
        2 => arbitrary(&mut input),
        _ => poses(&mut input),
    }
}

/// Returns a matrix with up to eight numbers replaced.
fn matrix(input: &mut Input, rows: usize, columns: usize) -> DMatrix<f64> {
    let mut out = DMatrix::from_fn(rows, columns, |r, i| ((r * columns + i) as f64 * 0.7).sin());
    for _ in 0..input.below(9) {
        if rows * columns > 0 {
            let at = input.below(rows * columns);
            out[at] = input.number(out[at]);
        }
    }
    if input.below(8) == 1 && rows > 1 {
        let first = out.row(0).into_owned();
        out.set_row(1, &first);
    }
    out
}

/// Returns the result; `None` for an error. Panics if the result is not finite or the error does not name its cause.
fn checked(what: &str, result: pliant_core::Result<DMatrix<f64>>) -> Option<DMatrix<f64>> {
    match result {
        Ok(values) => {
            assert!(values.iter().all(|value| value.is_finite()), "{what}: {values}");
            Some(values)
        }
        Err(error) => {
            assert_explained(&error);
            None
        }
    }
}

fn chain(input: &mut Input) {
    let (k, n) = (input.below(8), input.below(18));
    let jacobian = matrix(input, k, n);
    let damping = input.number(0.05);
    let kind = input.pick(&[Projector::Exact, Projector::Paper]);
    let inverse = checked("J⁺", damped_pseudo_inverse(&jacobian, damping));
    let projector = checked("N", null_space_projector(&jacobian, damping, kind));
    let (Some(inverse), Some(projector)) = (inverse, projector) else { return };
    let gradient: Vec<f64> = input.vector(&vec![0.3; n]);
    let dx = input.vector(&vec![0.1; k]);
    checked("R", responsibility(&inverse, &dx, &projector, &gradient, input.number(0.5)));
    let Some(a) = checked("A", activation(&inverse, &projector, input.flag().then_some(&gradient[..]))) else { return };
    assert!(a.iter().all(|share| (0.0..=1.0 + 1e-9).contains(share)), "{a}");
    match joint_torque_limits(&a, &input.vector(&vec![2.0; k + 1])) {
        Ok(limits) => assert!(limits.iter().all(|limit| limit.is_finite()), "{limits}"),
        Err(error) => assert_explained(&error),
    }
}

fn arbitrary(input: &mut Input) {
    let (k, n) = (input.below(7), input.below(17));
    let (inverse, projector) = (matrix(input, n, k), matrix(input, n, n));
    let gradient = input.vector(&vec![0.3; n]);
    checked("R", responsibility(&inverse, &input.vector(&vec![0.1; k]), &projector, &gradient, input.number(0.5)));
    if let Some(a) = checked("A", activation(&inverse, &projector, Some(&gradient))) {
        match joint_torque_limits(&a, &input.vector(&vec![2.0; k + 1])) {
            Ok(limits) => assert!(limits.iter().all(|limit| limit.is_finite()), "{limits}"),
            Err(error) => assert_explained(&error),
        }
    }
}

fn lists(input: &mut Input) {
    let k = input.below(7);
    let mut list = |usual: f64| input.vector(&vec![usual; k]);
    let (deviation, soft_until, firm_from) = (list(0.05), list(0.01), list(0.1));
    let (soft, firm, hold) = (list(1.0), list(4.0), list(8.0));
    let compliant: Vec<bool> = (0..k).map(|_| input.flag()).collect();
    match compliance(&deviation, &soft_until, &firm_from) {
        Ok(c) => {
            assert!(c.iter().all(|c| (0.0..=1.0).contains(c)), "{c:?}");
            match holding_torque(&c, &soft, &firm, &hold, &compliant) {
                Ok(torque) => assert!(torque.iter().all(|torque| torque.is_finite()), "{torque:?}"),
                Err(error) => assert_explained(&error),
            }
        }
        Err(error) => assert_explained(&error),
    }
}

fn poses(input: &mut Input) {
    let rotation = std::array::from_fn(|_| input.number(0.5));
    let position = std::array::from_fn(|_| input.number(0.2));
    let target = match Pose::from_rotation_vector(position, rotation) {
        Ok(pose) => pose,
        Err(error) => return assert_explained(&error),
    };
    let actual = pose(input, &target);
    match adapt_target(&actual, &target, input.number(0.5), std::array::from_fn(|_| input.flag())) {
        Ok(pose) => assert!(pose.validate().is_ok(), "{pose:?}"),
        Err(error) => assert_explained(&error),
    }
    match pose_error(&actual, &target) {
        Ok(error) => {
            assert!(error.iter().all(|value| value.is_finite()), "{error:?}");
            let turn: f64 = error[3..].iter().map(|value| value * value).sum::<f64>().sqrt();
            assert!(turn <= std::f64::consts::PI + 1e-9, "{error:?}");
        }
        Err(error) => assert_explained(&error),
    }
}
