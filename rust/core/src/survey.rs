//! What an arm can do on average over its joint space: scales from which defaults are made.

use nalgebra::DMatrix;

use crate::kinematics::{Frames, Masses};
use crate::law::svd::singular_values;
use crate::model::Model;
use crate::task::axes::Frame;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Number of poses.
const POSES: u32 = 512;

/// Bases of the Halton sequence, one per joint.
const PRIMES: [u32; MAX_JOINTS] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53];

/// The first 512 Halton points inside the position limits (±π for continuous joints).
pub(crate) fn poses(model: &Model) -> impl Iterator<Item = JointVec> + '_ {
    (1..=POSES).map(|index| {
        let mut q = [0.0; MAX_JOINTS];
        let range = model.lower().iter().zip(model.upper());
        for ((value, (&lower, &upper)), base) in q.iter_mut().zip(range).zip(PRIMES) {
            let (low, high) = if lower.is_finite() && upper.is_finite() {
                (lower, upper)
            } else {
                (-std::f64::consts::PI, std::f64::consts::PI)
            };
            *value = low + radical_inverse(index, base) * (high - low);
        }
        q
    })
}

/// Median over the poses of the smallest singular value of the task rows, translations divided by `length`.
///
/// Of the rows in base axes for a task in the tool's axes too: those of a full translation or rotation differ by a
/// rotation only, which changes no singular value.
pub(crate) fn median_sigma(model: &Model, axes: &[usize], frame: &Frame, length: f64) -> f64 {
    let n = model.n();
    let mut frames = Frames::default();
    let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut values: Vec<f64> = poses(model)
        .map(|q| {
            model.chain().forward(&q, &mut frames);
            model.chain().jacobian(&frames, &mut world);
            let rows = crate::task::rows(&world, &crate::task::base_from_task(frame, &frames.tool), axes);
            let matrix =
                DMatrix::from_fn(axes.len(), n, |r, i| if axes[r] < 3 { rows[r][i] / length } else { rows[r][i] });
            singular_values(&matrix).min()
        })
        .collect();
    median(&mut values)
}

/// Median static capacity of the arm: the push [N] and the twist [N·m] that its torques can answer, over the poses, the
/// three base axes and both signs: `min_i (usable_i + s_i g_i) / |J_ji|`.
pub(crate) fn static_capacity(model: &Model, usable: &JointVec, masses: &Masses, gravity: [f64; 3]) -> [f64; 2] {
    let mut frames = Frames::default();
    let mut world: Rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut holding = [0.0; MAX_JOINTS];
    let (mut forces, mut moments) = (Vec::new(), Vec::new());
    for q in poses(model) {
        model.chain().forward(&q, &mut frames);
        model.chain().jacobian(&frames, &mut world);
        model.chain().gravity(&frames, masses, gravity, &mut holding);
        for (axis, row) in world.iter().enumerate() {
            for sign in [-1.0, 1.0] {
                let capacity = least_capacity(row, sign, usable, &holding, model.n());
                if capacity.is_finite() {
                    (if axis < 3 { &mut forces } else { &mut moments }).push(capacity);
                }
            }
        }
    }
    [median(&mut forces), median(&mut moments)]
}

fn least_capacity(row: &JointVec, sign: f64, usable: &JointVec, holding: &JointVec, n: usize) -> f64 {
    let largest = row.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
    let mut least = f64::INFINITY;
    for i in 0..n.min(MAX_JOINTS) {
        let a = row[i] * sign;
        if a.abs() > 1e-9 * largest {
            least = least.min((usable[i] + a.signum() * holding[i]) / a.abs());
        }
    }
    least
}

/// A value rounded to two significant digits: 0.1465 → 0.15.
pub(crate) fn round_to_two_digits(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 0.0;
    }
    let step = 10.0_f64.powf(value.log10().floor() - 1.0);
    (value / step).round() * step
}

/// A value rounded to halves of its leading decade: 4.03 → 4, 15.1 → 15, 0.948 → 0.95.
pub(crate) fn round_to_halves(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 0.0;
    }
    let step = 0.5 * 10.0_f64.powf(value.log10().floor());
    (value / step).round() * step
}

pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        len if len % 2 == 1 => values[len / 2],
        len => 0.5 * (values[len / 2 - 1] + values[len / 2]),
    }
}

fn radical_inverse(mut index: u32, base: u32) -> f64 {
    let (mut inverse, mut scale) = (0.0, 1.0);
    while index > 0 {
        scale /= f64::from(base);
        inverse += scale * f64::from(index % base);
        index /= base;
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halton() {
        let values: Vec<f64> = (1..=4).map(|i| radical_inverse(i, 2)).collect();
        assert_eq!(values, [0.5, 0.25, 0.75, 0.125]);
    }

    #[test]
    fn rounding() {
        for (value, rounded) in [(4.03, 4.0), (15.1, 15.0), (0.948, 0.95), (40.3, 40.0), (3.555, 3.5), (0.0, 0.0)] {
            assert!((round_to_halves(value) - rounded).abs() < 1e-12);
        }
        for (value, rounded) in [(0.1465, 0.15), (0.0195, 0.02), (12.3, 12.0), (0.0, 0.0)] {
            assert!((round_to_two_digits(value) - rounded).abs() < 1e-12);
        }
    }
}
