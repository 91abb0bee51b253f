//! Mass matrix of the arm, with rigid groups as point masses.

use super::forward::JointFrames;
use super::gravity::GroupMasses;
use crate::MAX_JOINTS;
use crate::math::rows::JointMatrix;
use crate::math::simd::BaselineF64;
use crate::math::spatial::{Mat3, Vec3, add, cross, dot, rotate, sub};
use crate::model::Chain;

/// Sums over the point masses m [kg] beyond a joint, with their positions c [m] in base axes.
#[derive(Clone, Copy)]
struct CompositeMass {
    /// Total mass Σ m [kg].
    mass: f64,
    /// First moment Σ m c [kg·m].
    first: Vec3,
    /// Second moment Σ m c cᵀ [kg·m²].
    second: Mat3,
}

impl CompositeMass {
    const ZERO: Self = Self { mass: 0.0, first: [0.0; 3], second: [[0.0; 3]; 3] };

    #[inline]
    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.first = add::<BaselineF64>(&self.first, &other.first);
        for (row, more) in self.second.iter_mut().zip(&other.second) {
            *row = add::<BaselineF64>(row, more);
        }
    }

    /// Returns momentum [kg·m/s] and angular momentum about the base's origin [kg·m²/s] of all masses for a rotation at
    /// 1 rad/s about the line through `o` with the unit direction `axis`, z in the formulas below.
    #[inline]
    fn turning(&self, axis: &Vec3, o: &Vec3) -> (Vec3, Vec3) {
        // Σ m z × (c − o), and Σ m c × (z × (c − o)) with c × (z × c) = (c·c) z − c (c·z).
        let momentum = cross::<BaselineF64>(axis, &sub::<BaselineF64>(&self.first, &o.map(|x| self.mass * x)));
        let trace = self.second[0][0] + self.second[1][1] + self.second[2][2];
        let angular = sub::<BaselineF64>(&axis.map(|z| trace * z), &rotate::<BaselineF64>(&self.second, axis));
        (momentum, sub::<BaselineF64>(&angular, &cross::<BaselineF64>(&self.first, &cross::<BaselineF64>(axis, o))))
    }

    /// Returns momentum [kg·m/s] and angular momentum about the base's origin [kg·m²/s] of all masses for a motion at 1
    /// m/s along an axis.
    #[inline]
    fn sliding(&self, axis: &Vec3) -> (Vec3, Vec3) {
        (axis.map(|z| self.mass * z), cross::<BaselineF64>(&self.first, axis))
    }
}

impl Chain {
    /// Computes the mass matrix [kg·m²; kg for prismatic joints] `Σ_k m_k J_kᵀ J_k`, with each rigid group as a point
    /// mass at its centre of mass.
    ///
    /// Leaves out the groups' own moments of inertia, which [`GroupMasses`] does not contain, and the rotors. Groups
    /// beside the path count as fixed to the path.
    pub(crate) fn mass_matrix(&self, frames: &JointFrames, masses: &GroupMasses, out: &mut JointMatrix) {
        *out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        let (path, total) = (self.path.min(MAX_JOINTS), self.total.min(MAX_JOINTS));
        let mut groups = [CompositeMass::ZERO; MAX_JOINTS];
        for k in 0..total {
            let (mass, origin) = (masses.mass[k], frames.origin[k]);
            let moment = rotate::<BaselineF64>(&frames.rotation[k], &masses.moment[k]);
            let first = add::<BaselineF64>(&moment, &origin.map(|o| mass * o));
            if mass > 0.0 {
                let second = [0, 1, 2].map(|r| first.map(|c| first[r] * c / mass));
                groups[k] = CompositeMass { mass, first, second };
            }
        }
        for k in (path..total).rev() {
            let (parent, child) = (self.parent[k], groups[k]);
            if let Some(group) = groups.get_mut(parent) {
                group.add(&child);
            }
        }
        let mut subtree = CompositeMass::ZERO;
        for j in (0..path).rev() {
            subtree.add(&groups[j]);
            let (turn, slide) = (self.angle_per_q[j], self.slide_per_q[j]);
            let (axis, origin) = (&frames.axis[j], &frames.origin[j]);
            let (spun, pushed) = (subtree.turning(axis, origin), subtree.sliding(axis));
            let momentum = add::<BaselineF64>(&spun.0.map(|x| turn * x), &pushed.0.map(|x| slide * x));
            let moment = add::<BaselineF64>(&spun.1.map(|x| turn * x), &pushed.1.map(|x| slide * x));
            let column = self.driver[j] & (MAX_JOINTS - 1);
            for i in 0..=j {
                let (axis, origin) = (&frames.axis[i], &frames.origin[i]);
                let torque =
                    dot::<BaselineF64>(axis, &sub::<BaselineF64>(&moment, &cross::<BaselineF64>(origin, &momentum)));
                let entry = self.angle_per_q[i] * torque + self.slide_per_q[i] * dot::<BaselineF64>(axis, &momentum);
                let row = self.driver[i] & (MAX_JOINTS - 1);
                out[row][column] += entry;
                if i != j {
                    out[column][row] += entry;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JointVec;
    use crate::model::{Model, ModelOptions};

    /// Compares with `M = Σ m J_cᵀ J_c`, where the Jacobians J_c of the centres of mass are finite differences.
    #[test]
    fn the_matrix_agrees_with_differences_of_the_centres_of_mass() {
        let urdf = include_str!("../../robots/arm7.urdf");
        let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
        let model = Model::from_urdf_str(urdf, &options).unwrap();
        let (chain, masses) = (model.chain(), model.chain().masses(None));
        let centres = |q: &JointVec| {
            let mut frames = JointFrames::default();
            chain.forward(q, &mut frames);
            std::array::from_fn::<Vec3, 7, _>(|k| {
                let moment = rotate::<BaselineF64>(&frames.rotation[k], &masses.moment[k]);
                add::<BaselineF64>(
                    &frames.origin[k],
                    &moment.map(|x| if masses.mass[k] > 0.0 { x / masses.mass[k] } else { 0.0 }),
                )
            })
        };
        let mut q = [0.0; MAX_JOINTS];
        q[..7].copy_from_slice(&[-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]);
        let step = 1e-6;
        let columns: Vec<[Vec3; 7]> = (0..7)
            .map(|i| {
                let (mut low, mut high) = (q, q);
                (low[i], high[i]) = (q[i] - step, q[i] + step);
                let (a, b) = (centres(&low), centres(&high));
                std::array::from_fn(|k| sub::<BaselineF64>(&b[k], &a[k]).map(|x| x / (2.0 * step)))
            })
            .collect();
        let (mut frames, mut found) = (JointFrames::default(), [[0.0; MAX_JOINTS]; MAX_JOINTS]);
        chain.forward(&q, &mut frames);
        chain.mass_matrix(&frames, &masses, &mut found);
        for i in 0..7 {
            for j in 0..7 {
                let expected: f64 =
                    (0..7).map(|k| masses.mass[k] * dot::<BaselineF64>(&columns[i][k], &columns[j][k])).sum();
                assert!((found[i][j] - expected).abs() < 1e-8, "{i} {j}: {} {expected}", found[i][j]);
            }
        }
        assert!(found[0][0] > 0.05, "the arm has a mass");
    }
}
