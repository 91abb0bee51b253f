//! Medians over the arm's joint space, by which default settings are scaled.

use std::fmt::Write as _;

use nalgebra::DMatrix;

use crate::error::{Error, Result};
use crate::kinematics::statics::static_force;
use crate::kinematics::{GroupMasses, JointFrames};
use crate::math::halton;
use crate::math::rows::JointMatrix;
use crate::math::svd::singular_values;
use crate::model::Model;
use crate::params::{Frame, ServoArrays};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Number of configurations that sample the joint space. Miri takes minutes for 512.
const CONFIGURATIONS: u32 = if cfg!(miri) { 4 } else { 512 };

/// Number of configurations for the time constants of the axes.
const TIME_CONSTANT_CONFIGURATIONS: usize = 64;

/// Cached medians over the joint space of one arm with one set of servos.
///
/// Computing them takes milliseconds, longer than a control step may take. The controller keeps them for the next
/// change of settings.
#[derive(Debug, Clone, Default)]
pub(crate) struct JointSpaceStats {
    /// Cache key (axes, frame, length) and value: the median smallest singular value.
    sigma: Option<(Vec<usize>, Frame, f64, f64)>,
    /// Cache key (usable torques [N·m]) and value: the median static force [N] and torque [N·m].
    capacity: Option<(JointVec, [f64; 2])>,
    /// Cache key (axes, frame, the servos' `kp` and `armature`) and value: the squared time constants [s²].
    time_constants: Option<(Vec<usize>, Frame, [JointVec; 2], AxisVec)>,
}

impl JointSpaceStats {
    /// Returns the median smallest singular value of the task rows, see [`median_sigma`]; cached for these axes, frame
    /// and length.
    pub(crate) fn median_sigma(&mut self, model: &Model, axes: &[usize], frame: &Frame, length: f64) -> f64 {
        if let Some((cached_axes, cached_frame, cached_length, sigma)) = &self.sigma
            && cached_axes == axes
            && cached_frame == frame
            && cached_length.to_bits() == length.to_bits()
        {
            return *sigma;
        }
        let sigma = median_sigma(model, axes, frame, length);
        self.sigma = Some((axes.to_vec(), *frame, length, sigma));
        sigma
    }

    /// Returns the median squared time constants [s²] of the task axes, see [`squared_time_constants`]; cached for
    /// these axes, frame and servos.
    pub(crate) fn squared_time_constants(
        &mut self,
        model: &Model,
        servos: &ServoArrays,
        axes: &[usize],
        frame: &Frame,
    ) -> AxisVec {
        let joints = [servos.kp, servos.armature];
        if let Some((cached_axes, cached_frame, cached_joints, time_constants)) = &self.time_constants
            && cached_axes == axes
            && cached_frame == frame
            && cached_joints.map(|v| v.map(f64::to_bits)) == joints.map(|v| v.map(f64::to_bits))
        {
            return *time_constants;
        }
        let time_constants = squared_time_constants(model, servos, axes, frame);
        self.time_constants = Some((axes.to_vec(), *frame, joints, time_constants));
        time_constants
    }

    /// Returns the median static force [N] and torque [N·m] of the arm with the model's own payload and gravity, see
    /// [`static_capacity`]; cached for these usable torques.
    pub(crate) fn static_capacity(&mut self, model: &Model, usable: &JointVec) -> [f64; 2] {
        if let Some((cached_usable, capacity)) = &self.capacity
            && cached_usable.map(f64::to_bits) == usable.map(f64::to_bits)
        {
            return *capacity;
        }
        let masses = model.chain().masses(model.payload());
        let capacity = static_capacity(model, usable, &masses, model.gravity_vector());
        self.capacity = Some((*usable, capacity));
        capacity
    }
}

/// Returns the squared time constant [s²] of each task axis, its inertia times the compliance of the servos: the median
/// over 64 configurations of `Λ_jj C_jj`, with `Λ_jj = 1 / (J M⁻¹ Jᵀ)_jj` and `C = J K_p⁻¹ Jᵀ`, where M is the mass
/// matrix. 0 if the masses are unknown.
fn squared_time_constants(model: &Model, servos: &ServoArrays, axes: &[usize], frame: &Frame) -> AxisVec {
    let (n, chain) = (model.n(), model.chain());
    let masses = chain.masses(model.payload());
    let (mut frames, mut j_base) = (JointFrames::default(), [[0.0; MAX_JOINTS]; MAX_AXES]);
    let mut inertia: JointMatrix = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    let mut samples: [Vec<f64>; MAX_AXES] = std::array::from_fn(|_| Vec::new());
    for q in sample_configurations(model).take(TIME_CONSTANT_CONFIGURATIONS) {
        chain.forward(&q, &mut frames);
        chain.jacobian(&frames, &mut j_base);
        chain.mass_matrix(&frames, &masses, &mut inertia);
        let rows = crate::kinematics::task_rows(&j_base, &frame.base_from_task(&frames.tool.rotation), axes);
        let matrix = DMatrix::from_fn(n, n, |i, j| inertia[i][j] + if i == j { servos.armature[i] } else { 0.0 });
        let Some(factor) = matrix.cholesky() else { continue };
        for (row, samples) in rows.iter().zip(&mut samples).take(axes.len()) {
            let along = DMatrix::from_fn(n, 1, |i, _| row[i]);
            let mobility = along.dot(&factor.solve(&along));
            let compliance: f64 = (0..n).map(|i| row[i] * row[i] * servos.compliance[i]).sum();
            if mobility > 0.0 && (compliance / mobility).is_finite() {
                samples.push(compliance / mobility);
            }
        }
    }
    samples.map(|mut values| median(&mut values))
}

/// Returns the first 512 Halton points inside the position limits (±π for continuous joints) [rad or m].
pub(crate) fn sample_configurations(model: &Model) -> impl Iterator<Item = JointVec> + '_ {
    (1..=CONFIGURATIONS).map(|index| halton::joints(model.lower(), model.upper(), index))
}

/// Returns the median of the smallest singular value of the task rows, with translations divided by `length`.
fn median_sigma(model: &Model, axes: &[usize], frame: &Frame, length: f64) -> f64 {
    let n = model.n();
    median_over_rows(model, axes, frame, |rows| {
        let matrix = DMatrix::from_fn(axes.len(), n, |r, i| if axes[r] < 3 { rows[r][i] / length } else { rows[r][i] });
        singular_values(&matrix).min()
    })
}

/// Returns the median of a function of the task rows over the sampled configurations.
pub(crate) fn median_over_rows(model: &Model, axes: &[usize], frame: &Frame, of: impl Fn(&Rows) -> f64) -> f64 {
    let mut frames = JointFrames::default();
    let mut j_base = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut values: Vec<f64> = sample_configurations(model)
        .map(|q| {
            model.chain().forward(&q, &mut frames);
            model.chain().jacobian(&frames, &mut j_base);
            of(&crate::kinematics::task_rows(&j_base, &frame.base_from_task(&frames.tool.rotation), axes))
        })
        .collect();
    median(&mut values)
}

/// Returns the median force [N] and torque [N·m] that the joint torques can hold, over the sampled configurations, the
/// base axes and both signs: `min_i (usable_i + s_i g_i) / |J_ji|`, where s_i is the sign of ±J_ji.
fn static_capacity(model: &Model, usable: &JointVec, masses: &GroupMasses, gravity: [f64; 3]) -> [f64; 2] {
    let mut frames = JointFrames::default();
    let mut j_base: Rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut holding = [0.0; MAX_JOINTS];
    let (mut forces, mut moments) = (Vec::new(), Vec::new());
    for q in sample_configurations(model) {
        model.chain().forward(&q, &mut frames);
        model.chain().jacobian(&frames, &mut j_base);
        model.chain().gravity(&frames, masses, gravity, &mut holding);
        for (axis, row) in j_base.iter().enumerate() {
            for sign in [-1.0, 1.0] {
                let capacity = static_force(row, sign, usable, &holding, model.n());
                if capacity.is_finite() {
                    (if axis < 3 { &mut forces } else { &mut moments }).push(capacity);
                }
            }
        }
    }
    [median(&mut forces), median(&mut moments)]
}

/// Returns the joints whose servo cannot hold the weight of the arm in all sampled configurations, as a text with the
/// largest torques that they need [N·m]; empty if there are none.
pub(crate) fn excess_weight(model: &Model, usable: &JointVec) -> String {
    let (masses, mut frames) = (model.chain().masses(model.payload()), JointFrames::default());
    let (mut holding, mut largest) = ([0.0; MAX_JOINTS], [0.0_f64; MAX_JOINTS]);
    for q in sample_configurations(model) {
        model.chain().forward(&q, &mut frames);
        model.chain().gravity(&frames, &masses, model.gravity_vector(), &mut holding);
        for (largest, torque) in largest.iter_mut().zip(&holding) {
            *largest = largest.max(torque.abs());
        }
    }
    let mut text = String::new();
    for (name, (largest, usable)) in model.joint_names().iter().zip(largest.iter().zip(usable)) {
        if largest > usable {
            let _ = write!(text, "; {name} needs up to {largest:.3} N·m, its servo has {usable:.3} N·m");
        }
    }
    text
}

/// Returns an error if the servos cannot hold the arm in any sampled configuration, e.g. because a mass is in grams or
/// the servo data are wrong.
pub(crate) fn check_holding(model: &Model, usable: &JointVec, masses: &GroupMasses, gravity: [f64; 3]) -> Result<()> {
    let (mut frames, mut holding) = (JointFrames::default(), [0.0; MAX_JOINTS]);
    // Largest load (|torque| / usable torque) of a joint, with this joint and its torque [N·m], in the configuration
    // for which that load is smallest.
    let mut best = (f64::INFINITY, 0, 0.0);
    for q in sample_configurations(model) {
        model.chain().forward(&q, &mut frames);
        model.chain().gravity(&frames, masses, gravity, &mut holding);
        let mut worst = (0.0, 0, 0.0);
        for i in 0..model.n() {
            let share = holding[i].abs() / usable[i];
            if share > worst.0 {
                worst = (share, i, holding[i].abs());
            }
        }
        if worst.0 < best.0 {
            best = worst;
        }
        if best.0 <= 1.0 {
            return Ok(());
        }
    }
    let (share, joint, torque) = best;
    let name = model.joint_names().get(joint).map_or("", String::as_str);
    Err(Error::out_of_range(
        format!("torque that holds the arm at joint {name} [N·m]"),
        torque,
        format!(
            "±{} even in the best of {CONFIGURATIONS} poses ({share:.1} times too much): check masses [kg], payload [kg] and the \
             servos' torque [N·m]",
            usable[joint]
        ),
    ))
}

/// Returns the median of `values`, which it sorts; 0 if there are none.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        len if len % 2 == 1 => values[len / 2],
        len => 0.5 * (values[len / 2 - 1] + values[len / 2]),
    }
}
