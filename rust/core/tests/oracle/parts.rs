//! Properties of the arm, the servos and the axes that the oracle computes before it evaluates a law.

use nalgebra::{Matrix3, Rotation3, Vector3};
use pliant_core::params::{CompliantSide, Frame, Gain, Law, Profile};
use pliant_core::{LimitType, Pose, Reference, Servos, StepInput};

use super::{Matrix, Oracle, Row, Vector};

impl Oracle {
    pub(super) fn n(&self) -> usize {
        self.model.n()
    }

    /// Returns the indices of the task's axes among x, y, z, roll, pitch, yaw.
    pub(crate) fn axes(&self) -> Vec<usize> {
        (0..6).filter(|&axis| self.settings.task.axes[axis]).collect()
    }

    /// Returns the length [m] by which translations are divided: reach / 0.71, or with more axes than joints the task's
    /// length.
    pub(super) fn length(&self) -> f64 {
        if self.axes().len() > self.n() { self.settings.task.length.unwrap() } else { self.model.reach() / 0.71 }
    }

    pub(super) fn joint(&self, of: impl Fn(&Servos) -> &Vec<f64>, otherwise: f64) -> Vector {
        self.servos.as_ref().map_or(Vector::repeat(self.n(), otherwise), |s| Vector::from_column_slice(of(s)))
    }

    pub(super) fn kp(&self) -> Vector {
        self.joint(|s| &s.kp, 1.0)
    }

    /// Returns the viscous damping of each joint: of the gears, the derivative gain, and with a PWM limit the back-EMF
    /// τ_stall / w₀.
    pub(super) fn resistance(&self) -> Vector {
        let back_emf = match self.servos.as_ref() {
            Some(s) if s.limit_type == LimitType::Pwm => self
                .joint(|s| &s.max_torque, 0.0)
                .component_div(&self.joint(|s| s.no_load_speed.as_ref().unwrap(), 1.0)),
            _ => Vector::zeros(self.n()),
        };
        self.joint(|s| &s.damping, 0.0) + self.joint(|s| &s.kv, 0.0) + back_emf
    }

    /// Returns true if `d/k_p ≥ 0.04 s` in every joint.
    pub(super) fn well_damped(&self) -> bool {
        self.resistance().iter().zip(self.kp().iter()).all(|(d, kp)| d / kp >= 0.04)
    }

    pub(super) fn ceiling(&self) -> Vector {
        match &self.servos {
            Some(s) => Vector::from_column_slice(&s.max_torque),
            None => Vector::from_fn(self.n(), |i, _| self.model.effort_limit()[i].unwrap_or(f64::INFINITY)),
        }
    }

    /// Returns the margin of the limits: m = max(share of the usable torque, 2 τ_f) [N·m].
    pub(super) fn margin(&self) -> Vector {
        let friction = self.joint(|s| &s.friction, 0.0);
        let usable = self.ceiling().map(|t| if t.is_finite() { self.settings.torque_limits.margin * t } else { 0.0 });
        usable.zip_map(&friction, |m, f| m.max(2.0 * f))
    }

    pub(crate) fn base_from_task(&self, tool: &Pose) -> Matrix3<f64> {
        let of = |r: &[[f64; 3]; 3]| Matrix3::from_fn(|i, j| r[i][j]);
        match &self.settings.task.frame {
            Frame::Base => Matrix3::identity(),
            Frame::Tool => of(&tool.rotation),
            Frame::Rotation(r) => of(r),
        }
    }

    /// Returns the rows of the task's axes at `q`, in the task frame.
    pub(crate) fn rows(&self, q: &Vector) -> Matrix {
        let (tool, jacobian) = self.model.kinematics(q.as_slice(), Reference::WorldAligned).unwrap();
        let turn = self.base_from_task(&tool).transpose();
        let linear = turn * jacobian.fixed_rows::<3>(0);
        let angular = turn * jacobian.fixed_rows::<3>(3);
        let axes = self.axes();
        Matrix::from_fn(axes.len(), self.n(), |r, i| {
            if axes[r] < 3 { linear[(axes[r], i)] } else { angular[(axes[r] - 3, i)] }
        })
    }

    /// Returns the rows with translations divided by [`Oracle::length`].
    pub(crate) fn scaled(&self, rows: &Matrix) -> Matrix {
        let (axes, length) = (self.axes(), self.length());
        Matrix::from_fn(
            rows.nrows(),
            rows.ncols(),
            |r, i| if axes[r] < 3 { rows[(r, i)] / length } else { rows[(r, i)] },
        )
    }

    /// Returns the deviation along the task axes: position difference and rotation vector of `R_d Rᵀ`, in the task
    /// frame.
    pub(crate) fn deviation(&self, tool: &Pose, target: &Pose) -> Vector {
        let of = |r: &[[f64; 3]; 3]| Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| r[i][j]));
        let turn = (of(&target.rotation) * of(&tool.rotation).inverse()).scaled_axis();
        let position = Vector3::from(target.position) - Vector3::from(tool.position);
        self.in_task(tool, &position, &turn)
    }

    pub(super) fn in_task(&self, tool: &Pose, linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector {
        let turn = self.base_from_task(tool).transpose();
        let (linear, angular) = (turn * linear, turn * angular);
        let axes = self.axes();
        Vector::from_fn(axes.len(), |r, _| if axes[r] < 3 { linear[axes[r]] } else { angular[axes[r] - 3] })
    }

    /// Computes lines 3 to 5 of the listing for one axis with deviation `e`.
    pub(super) fn row(&self, axis: usize, e: f64) -> Row {
        let (axis_settings, paper) = (&self.settings.axes[axis], self.settings.law == Law::Paper);
        let translation = axis < 3;
        let soft_until = axis_settings.soft_until.unwrap_or(if translation { 0.01 } else { 0.04 });
        let firm_from = axis_settings.firm_from.unwrap_or(if translation { 0.1 } else { 0.4 });
        let band = soft_until * self.settings.paper_options.direction_band.unwrap_or(if paper { 0.0 } else { 0.1 });
        // Pushed toward +, the tool is beyond its target: e < 0.
        let toward_plus = if e <= -band && (band > 0.0 || e < 0.0) {
            1.0
        } else if e >= band {
            0.0
        } else {
            0.5 - 0.5 * e / band
        };
        let mix = |pair: [f64; 2]| pair[0] * (1.0 - toward_plus) + pair[1] * toward_plus;
        let w = match axis_settings.compliant_side() {
            CompliantSide::Both => 1.0,
            CompliantSide::None => 0.0,
            CompliantSide::Plus => toward_plus,
            CompliantSide::Minus => 1.0 - toward_plus,
        };
        let adapted = e - axis_settings.adaptation * w * e;
        let seen = if self.settings.paper_options.raw_deviation { e.abs() } else { adapted.abs() };
        let c = if seen <= soft_until {
            1.0
        } else if seen >= firm_from {
            0.0
        } else {
            1.0 - (seen - soft_until) / (firm_from - soft_until)
        };
        let (soft, firm) = (mix(axis_settings.soft.unwrap()), mix(axis_settings.firm.unwrap()));
        let strength = match axis_settings.profile {
            Profile::Hardening => c * soft + (1.0 - c) * firm,
            Profile::Constant => soft,
            Profile::Softening => c * firm + (1.0 - c) * soft,
        };
        Row {
            e,
            adapted,
            w,
            c,
            strength,
            max_strength: w * strength + (1.0 - w) * axis_settings.hold.unwrap(),
            stiffness: axis_settings.stiffness.map_or(0.0, mix),
            viscosity: axis_settings.damping.map_or(0.0, mix),
        }
    }

    /// Returns the limit of the commanded task velocity of an axis with softness `w`, between those of a stiff and of a
    /// soft axis.
    pub(super) fn velocity_limit(&self, axis: usize, w: f64) -> f64 {
        let axis_settings = &self.settings.axes[axis];
        let stiff = axis_settings.max_velocity.unwrap_or(if axis < 3 { 0.4 } else { 2.0 });
        let soft = self.soft_velocity_limit(axis);
        match w {
            w if w <= 0.0 => stiff,
            w if w >= 1.0 => soft,
            w if stiff.is_finite() && soft.is_finite() => (1.0 - w) * stiff + w * soft,
            _ => stiff,
        }
    }

    pub(super) fn soft_velocity_limit(&self, axis: usize) -> f64 {
        self.settings.axes[axis].soft_step_limit.unwrap_or(match (self.settings.law, axis < 3) {
            (Law::Paper, true) => 0.1,
            (Law::Paper, false) => 0.5,
            _ => f64::INFINITY,
        })
    }

    pub(super) fn gain(gain: &Gain, size: usize) -> Matrix {
        match gain {
            Gain::Scalar(k) => Matrix::identity(size, size) * *k,
            Gain::Diagonal(d) => Matrix::from_diagonal(&Vector::from_column_slice(d)),
            Gain::Matrix(m) => Matrix::from_fn(size, size, |i, j| m[i][j]),
        }
    }

    /// Returns the gradient in line 9 of the listing: posture, joint limits and the caller's cost; without
    /// manipulability.
    pub(super) fn gradient(&self, q: &Vector, input: &StepInput<'_>, axis_values: &[Row]) -> Vector {
        let n = self.n();
        let rest = match (input.posture, &self.settings.null_space.posture) {
            (Some(p), _) => Vector::from_column_slice(p),
            (None, Some(p)) => Vector::from_column_slice(p),
            (None, None) => self.state.rest.clone(),
        };
        // Closer to a position limit than w (0.05 rad or 5 % of the range), the posture task fades, to 0 at w / 2. If
        // the rest posture is closer to the limit than w, the fade starts there, with that distance (at least 0.4 w) as
        // w.
        let mut share = 1.0_f64;
        if self.settings.law != Law::Paper && self.settings.task.axes.iter().filter(|&&on| on).count() < n {
            for i in 0..n {
                let (lower, upper) = (self.model.lower()[i], self.model.upper()[i]);
                let clearance = (0.05 * (upper - lower)).min(0.05);
                for (room, at_rest) in [(q[i] - lower, rest[i] - lower), (upper - q[i], upper - rest[i])] {
                    let width = at_rest.max(0.4 * clearance).min(clearance);
                    share = share.min(1.0 - 2.0 * (at_rest.min(width) - room) / width);
                }
            }
        }
        // The fade is multiplied by the strength of the push on a yielding axis: 0 up to a deviation of d⁻ (at least
        // 0.1 d⁺), 1 above twice this deviation.
        let push_fractions = axis_values.iter().zip(self.axes()).map(|(row, axis)| {
            let (axis_settings, [low, high]) =
                (&self.settings.axes[axis], if axis < 3 { [0.01, 0.1] } else { [0.04, 0.4] });
            let near = axis_settings.soft_until.unwrap_or(low).max(0.1 * axis_settings.firm_from.unwrap_or(high));
            row.w * (row.e.abs() / near - 1.0).clamp(0.0, 1.0)
        });
        let share = 1.0 - (1.0 - share.max(0.0)) * push_fractions.fold(0.0, f64::max);
        let mut out = Vector::zeros(n);
        for i in 0..n {
            let weight = share * self.settings.paper_options.posture_weights.as_ref().map_or(1.0, |w| w[i]);
            out[i] = weight * (q[i] - rest[i]) + input.gradient.map_or(0.0, |g| g[i]);
            let (lower, upper) = (self.model.lower()[i], self.model.upper()[i]);
            if lower.is_finite() && upper.is_finite() {
                let half = 0.5 * (upper - lower);
                out[i] += self.settings.null_space.limit_avoidance * (q[i] - lower - half) / (half * half);
            }
        }
        out
    }
}
