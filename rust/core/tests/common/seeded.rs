//! Random numbers that are identical on every machine, and arms with their servos.
#![allow(dead_code, reason = "each test program that includes this file uses a part of it")]

use std::f64::consts::PI;
use std::sync::Arc;

use pliant_core::{Model, ModelOptions, Pose, Servos};

/// SplitMix64 random generator.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Returns a number uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a number between `low` and `high` whose logarithm is uniform.
    pub(crate) fn scale(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    pub(crate) fn below(&mut self, count: usize) -> usize {
        usize::try_from(self.next() >> 32).unwrap() % count
    }

    pub(crate) fn pick<T: Clone>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())].clone()
    }

    pub(crate) fn vector(&mut self, n: usize, size: f64) -> Vec<f64> {
        (0..n).map(|_| self.between(-size, size)).collect()
    }

    pub(crate) fn rotation(&mut self) -> [[f64; 3]; 3] {
        let v = self.vector(3, 2.5);
        Pose::from_rotation_vector([0.0; 3], [v[0], v[1], v[2]]).unwrap().rotation
    }

    /// Returns positions in the middle `share` of the joint ranges (±π for joints without limits).
    pub(crate) fn joints(&mut self, model: &Model, share: f64) -> Vec<f64> {
        (0..model.n())
            .map(|i| {
                let (low, high) = (model.lower()[i].max(-PI), model.upper()[i].min(PI));
                0.5 * (low + high) + share * self.between(-0.5, 0.5) * (high - low)
            })
            .collect()
    }

    /// Returns the pose at `q`, displaced by up to `metres` and `radians`.
    pub(crate) fn target(&mut self, model: &Model, q: &[f64], metres: f64, radians: f64) -> Pose {
        let mut pose = model.forward_kinematics(q).unwrap();
        let (p, v) = (self.vector(3, metres), self.vector(3, radians));
        let turn = Pose::from_rotation_vector([0.0; 3], [v[0], v[1], v[2]]).unwrap().rotation;
        let before = pose.rotation;
        for i in 0..3 {
            pose.position[i] += p[i];
            for j in 0..3 {
                pose.rotation[i][j] = (0..3).map(|k| turn[i][k] * before[k][j]).sum();
            }
        }
        // Move a target that is too far away inward until it is accepted.
        let centre = model.reach_origin();
        while model.check_target(&pose).is_err() {
            for (value, from) in pose.position.iter_mut().zip(centre) {
                *value += 0.01 * (from - *value);
            }
        }
        pose
    }
}

/// Returns an arm by index: 0: the built-in arm of seven joints; 1: the same with rotated mount and tool; 2: an arm of
/// five joints; 3: an arm of nine joints, more than the lanes of a vector register.
pub(crate) fn arm(index: usize, options: &ModelOptions) -> Arc<Model> {
    if index == 3 {
        return Arc::new(Model::from_urdf_str(&nine_joints(), options).unwrap());
    }
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let (file, tip) = [
        ("tests/data/golden/arm7.urdf", Some("tool")),
        ("benches/arm7_bench.urdf", None),
        ("python/pliant/robots/so101_like.urdf", Some("tool")),
    ][index];
    let options = ModelOptions { tip: tip.map(String::from), ..options.clone() };
    Arc::new(Model::from_urdf_file(format!("{root}/{file}"), &options).unwrap())
}

/// Returns the URDF of a chain of nine joints about y, z and x in turn, 0.1 m apart.
fn nine_joints() -> String {
    let joint = |i: usize| {
        let axis = ["0 1 0", "0 0 1", "1 0 0"][i % 3];
        let child = i + 1;
        format!(
            r#"<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{child}"/><axis xyz="{axis}"/>
            <origin xyz="0.03 0 0.1"/><limit lower="-1.5" upper="1.5" effort="10" velocity="3"/></joint>
            <link name="l{child}"><inertial><origin xyz="0 0 0.05"/><mass value="0.1"/>
            <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>"#
        )
    };
    let joints: String = (0..9).map(joint).collect();
    format!(r#"<robot name="nine"><link name="l0"/>{joints}</robot>"#)
}

/// Returns the servos of the arm that [`arm`] returns for the same index.
pub(crate) fn servos(index: usize) -> Servos {
    let spread = |shoulder: f64, wrist: f64| [vec![shoulder; 4], vec![wrist; 3]].concat();
    if index == 2 {
        return Servos {
            friction: vec![0.08],
            damping: vec![0.6],
            armature: vec![0.028],
            stiffness_known: true,
            ..Servos::new(vec![5.1], vec![1.9])
        };
    }
    if index == 3 {
        return Servos { friction: vec![0.1], stiffness_known: true, ..Servos::new(vec![100.0], vec![10.0]) };
    }
    Servos {
        friction: spread(0.2, 0.1),
        damping: spread(1.2, 0.8),
        kv: spread(1.5, 0.5),
        armature: spread(0.012, 0.008),
        stiffness_known: true,
        ..Servos::new(spread(150.0, 60.0), spread(10.7, 6.4))
    }
}
