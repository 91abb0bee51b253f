//! Reference governor: the reference follows the target within speed and acceleration bounds, and waits for an arm
//! whose torques or speeds are at their limits.

use crate::math::cold;
use crate::math::rotation::{rotation_matrix, rotation_matrix_by, task_to_base};
use crate::math::simd::{BaselineF64, RealOps};
use crate::math::spatial::{add, add_scaled, dot, multiply, norm, orthonormal, scale, sub};
use crate::params::Params;
use crate::pose::Pose;
use crate::task::{pose_error, pose_error_by};
use crate::{AxisVec, MAX_AXES};

/// Linear and angular distance between target and reference [m, rad] above which the reference may be held back.
const FAR_THRESHOLD: [f64; 2] = [0.05, 0.2];

/// Largest deceleration when the reference is held back [m/s², rad/s²]; an abrupt stop would shake the arm.
const MAX_HOLD_DECELERATION: [f64; 2] = [3.0, 12.0];

/// Trace, 1 + 2 cos, of a rotation by `FAR_THRESHOLD[1]`.
const TRACE_FAR_THRESHOLD: f64 = 2.960_133_155_682_483;

/// Reference pose that moves toward the target with bounded speed and acceleration.
///
/// The fields are few enough that a copy does not call memcpy.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReferenceGovernor {
    /// The reference, `base_from_tool`.
    pub(crate) pose: Pose,
    /// Velocity of the reference, linear [m/s] and angular [rad/s], base axes; zero if the speed limits are infinite.
    pub(crate) velocity: [f64; 6],
    /// Target of the last step.
    pub(crate) target: Pose,
    /// Linear and angular speed of the target in the last step [m/s, rad/s]; 0 if the target jumped.
    pub(crate) target_speed: [f64; 2],
}

impl ReferenceGovernor {
    /// Creates a reference at rest in `pose`.
    pub(crate) fn new(pose: Pose) -> Self {
        Self { pose, velocity: [0.0; 6], target: pose, target_speed: [0.0; 2] }
    }

    /// Returns the reference pose.
    pub(crate) fn pose(&self) -> Pose {
        self.pose
    }

    /// Sets the reference pose and its velocity (6,) [m/s, rad/s], base axes.
    pub(crate) fn set(&mut self, pose: Pose, velocity: [f64; 6]) {
        (self.pose, self.velocity) = (pose, velocity);
    }

    /// Returns two flags, for position and rotation: the reference equals the target of the last step exactly.
    #[inline(always)]
    pub(crate) fn arrived(&self) -> [bool; 2] {
        let (mut position, mut rotation) = (0, 0);
        for i in 0..3 {
            position |= self.pose.position[i].to_bits() ^ self.target.position[i].to_bits();
            for j in 0..3 {
                rotation |= self.pose.rotation[i][j].to_bits() ^ self.target.rotation[i][j].to_bits();
            }
        }
        [position == 0, rotation == 0]
    }

    /// Returns two flags, for position and rotation: the target is farther than [`FAR_THRESHOLD`] from the reference.
    /// False where `speed` is infinite, since the reference then equals the target.
    #[inline(always)]
    pub(crate) fn lags(&self, speed: [f64; 2]) -> [bool; 2] {
        let (mut squared, mut trace) = (0.0, 0.0);
        for i in 0..3 {
            squared += (self.target.position[i] - self.pose.position[i]).powi(2);
            for j in 0..3 {
                trace += self.target.rotation[i][j] * self.pose.rotation[i][j];
            }
        }
        [
            squared > FAR_THRESHOLD[0].powi(2) && speed[0].is_finite(),
            trace < TRACE_FAR_THRESHOLD && speed[1].is_finite(),
        ]
    }

    /// Undoes `share` of the motion that the reference has made since `before` along the deviation `lag` (6,), base
    /// axes. The bounds are speed [m/s, rad/s] and acceleration [m/s², rad/s²], each linear and angular. The
    /// deceleration is at most [`MAX_HOLD_DECELERATION`] plus the acceleration bound, which the step may have used.
    ///
    /// Motion perpendicular or opposite to `lag` is unchanged, so an arm pressed against an object slides along it.
    /// While the target is near, nothing is undone, so an arm whose target is slightly inside an object presses on it.
    pub(crate) fn hold_back(
        &mut self,
        before: &Pose,
        lag: &[f64; 6],
        share: f64,
        [speed, acceleration]: [[f64; 2]; 2],
        dt: f64,
    ) {
        let (mut moved, behind) = (pose_error(before, &self.pose), self.lags(speed));
        for b in 0..2 {
            let part = |v: &[f64; 6]| [v[3 * b], v[3 * b + 1], v[3 * b + 2]];
            let (d, m) = (part(lag), part(&moved));
            let gained = d[0] * m[0] + d[1] * m[1] + d[2] * m[2];
            let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            // A lag whose square underflows counts as zero, because it is a divisor below.
            if !behind[b] || gained <= 0.0 || squared < f64::MIN_POSITIVE {
                continue;
            }
            let max =
                (share * gained / squared).min((MAX_HOLD_DECELERATION[b] + acceleration[b]) * dt * dt / squared.sqrt());
            for i in 0..3 {
                moved[3 * b + i] -= max * d[i];
                self.velocity[3 * b + i] -= max * d[i] / dt;
            }
            if b == 0 {
                self.pose.position = add::<BaselineF64>(&before.position, &part(&moved));
            } else {
                self.pose.rotation = orthonormal::<BaselineF64>(&multiply::<BaselineF64>(
                    &rotation_matrix(part(&moved)),
                    &before.rotation,
                ));
            }
        }
    }

    /// Returns the velocity of the reference (6,) [m/s, rad/s], base axes.
    pub(crate) fn reference_velocity(&self) -> [f64; 6] {
        self.velocity
    }

    /// Returns the velocity to feed forward (6,) [m/s, rad/s], base axes: the target's `twist` bounded by `speed` once
    /// the reference has reached the target, until then the velocity of the reference.
    pub(crate) fn velocity(&self, twist: &[f64; 6], speed: [f64; 2]) -> [f64; 6] {
        let mut out = self.velocity;
        for (block, (&arrived, &max)) in self.arrived().iter().zip(&speed).enumerate() {
            if arrived {
                let from = 3 * block;
                let bounded = clamp_norm::<BaselineF64>([twist[from], twist[from + 1], twist[from + 2]], max);
                out[from..from + 3].copy_from_slice(&bounded);
            }
        }
        out
    }

    /// Moves the reference toward `target` for `dt` [s] and returns it.
    ///
    /// A reference at its target follows it exactly while the target moves within the bounds. Otherwise translation and
    /// rotation each approach the target and brake so that they can stop at it, v ≤ √(2 a d). With infinite speeds the
    /// reference is the target.
    #[inline(always)]
    pub(crate) fn update<A: RealOps<Real = f64>>(
        &mut self,
        target: &Pose,
        speed: [f64; 2],
        acceleration: [f64; 2],
        dt: f64,
    ) -> Pose {
        if speed.iter().all(|max| max.is_infinite()) {
            *self = Self::new(*target);
            return *target;
        }
        let moved = pose_error_by::<A>(&self.target, target);
        if self.arrived() == [true; 2] && self.follows::<A>(&moved, speed, acceleration, dt) {
            (self.pose, self.target) = (*target, *target);
            return *target;
        }
        cold();
        let e = pose_error_by::<A>(&self.pose, target);
        let mut blocks = [([0.0; 3], true); 2];
        for (b, block) in blocks.iter_mut().enumerate() {
            let part = |v: &[f64; 6]| [v[3 * b], v[3 * b + 1], v[3 * b + 2]];
            let (target_velocity_now, fast) = target_velocity::<A>(part(&moved), speed[b], dt);
            // The reference may brake as hard as its target does, so that it does not overshoot.
            let braked = (self.target_speed[b] - fast).max(0.0);
            self.target_speed[b] = fast;
            *block = approach::<A>(
                part(&e),
                part(&self.velocity),
                target_velocity_now,
                speed[b],
                [acceleration[b], braked],
                dt,
            );
        }
        let [(linear, at_position), (angular, at_rotation)] = blocks;
        self.target = *target;
        if at_position {
            self.pose.position = target.position;
        } else {
            for i in 0..3 {
                self.pose.position[i] = A::fma(linear[i], dt, self.pose.position[i]);
            }
        }
        if at_rotation {
            self.pose.rotation = target.rotation;
        } else {
            let turn = rotation_matrix_by::<A>([angular[0] * dt, angular[1] * dt, angular[2] * dt]);
            self.pose.rotation = orthonormal::<A>(&multiply::<A>(&turn, &self.pose.rotation));
        }
        self.velocity = [linear[0], linear[1], linear[2], angular[0], angular[1], angular[2]];
        self.pose
    }

    /// Gives a reference that was at its target the velocity of the target, which has moved by `moved` in `dt` [s].
    /// Returns false and changes nothing if that would exceed the bounds. The result is that of [`approach`], but takes
    /// less time.
    #[inline(always)]
    fn follows<A: RealOps<Real = f64>>(
        &mut self,
        moved: &[f64; 6],
        speed: [f64; 2],
        acceleration: [f64; 2],
        dt: f64,
    ) -> bool {
        let (mut velocity, mut target_speed) = ([0.0; 6], [0.0; 2]);
        for b in 0..2 {
            let part = |v: &[f64; 6]| [v[3 * b], v[3 * b + 1], v[3 * b + 2]];
            let (now, before) = (scale::<A>(1.0 / dt, &part(moved)), part(&self.velocity));
            let (size, change) = (norm::<A>(&now), sub::<A>(&now, &before));
            let max = acceleration[b] * dt + (self.target_speed[b] - size).max(0.0);
            // Negated, so that NaN is left to `approach`. So are motions without a speed limit, whose velocity is zero.
            if !(size <= speed[b] && speed[b].is_finite() && dot::<A>(&change, &change) <= max * max) {
                return false;
            }
            velocity[3 * b..3 * b + 3].copy_from_slice(&now);
            target_speed[b] = size;
        }
        (self.velocity, self.target_speed) = (velocity, target_speed);
        true
    }
}

/// If limits take away at least this share of the stiff axes' wrench or of the goals' motion, the reference stops.
const HOLD_THRESHOLD: f64 = 0.2;

/// Returns the degree, 0 to 1, to which the reference is held back. `share` is the share of the stiff axes' wrench that
/// the torques allow, or the share of the goals' motion that their speed limit allows, whichever is smaller.
#[inline(always)]
pub(crate) fn hold_fraction(share: f64) -> f64 {
    ((1.0 - share) / HOLD_THRESHOLD).min(1.0)
}

/// Inputs for holding back a reference that runs ahead of an arm whose stiff axes are at their limits.
pub(crate) struct ReferenceHold<'a> {
    pub(crate) params: &'a Params,
    /// Bounds on the reference: speed [m/s, rad/s], then acceleration [m/s², rad/s²], each linear and angular.
    pub(crate) bounds: [[f64; 2]; 2],
    pub(crate) base_from_task: &'a [[f64; 3]; 3],
    /// Deviation of each task row times its stiffness 1 − w [m, rad].
    pub(crate) lag: &'a AxisVec,
    /// Degree to which the reference is held back, 0 to 1.
    pub(crate) hold_fraction: f64,
    /// Period of the step [s].
    pub(crate) dt: f64,
}

impl ReferenceHold<'_> {
    /// Undoes a part of the motion that the reference has made along the deviation since the pose `before`.
    #[cold]
    #[inline(never)]
    pub(crate) fn apply(&self, before: &Pose, governor: &mut ReferenceGovernor) {
        let mut lag = [0.0; MAX_AXES];
        for (&axis, &value) in self.params.axes.iter().zip(self.lag) {
            lag[axis] = value;
        }
        governor.hold_back(before, &task_to_base(self.base_from_task, &lag), self.hold_fraction, self.bounds, self.dt);
    }
}

/// Returns the velocity of a target that moved by `moved` in `dt` [s], and its norm; both zero for a jump, which is a
/// motion faster than `speed`.
#[inline(always)]
fn target_velocity<A: RealOps<Real = f64>>(moved: [f64; 3], speed: f64, dt: f64) -> ([f64; 3], f64) {
    let velocity = scale::<A>(1.0 / dt, &moved);
    let size = norm::<A>(&velocity);
    if size <= speed { (velocity, size) } else { ([0.0; 3], 0.0) }
}

/// Returns the velocity of the reference for this period, and true if it reaches the target in this period. The target
/// is at the offset `d` from the reference; `v` is the reference's present velocity, `target_velocity_now` the
/// target's.
///
/// `max` is the largest acceleration, and an additional change of velocity allowed in this period.
#[inline(always)]
fn approach<A: RealOps<Real = f64>>(
    d: [f64; 3],
    v: [f64; 3],
    target_velocity_now: [f64; 3],
    speed: f64,
    max: [f64; 2],
    dt: f64,
) -> ([f64; 3], bool) {
    if !speed.is_finite() {
        return ([0.0; 3], true);
    }
    // A speed limit that was lowered during the motion takes effect immediately.
    let v = clamp_norm::<A>(v, speed);
    let behind = add_scaled::<A>(&d, -dt, &target_velocity_now);
    let distance = norm::<A>(&behind);
    // Speed from which braking for `periods` ends exactly at the target, the discrete form of √(2 a d). The step is
    // clamped to f64::MAX, because 0 · ∞ would be NaN.
    let step = (max[0] * dt).min(f64::MAX);
    let periods = (0.5 * ((1.0 + 8.0 * distance / (step * dt)).sqrt() - 1.0)).ceil().max(1.0);
    let braking = distance / (periods * dt) + 0.5 * step * (periods - 1.0);
    let closing = if distance > 0.0 { braking / distance } else { 0.0 };
    let wanted = clamp_norm::<A>(add_scaled::<A>(&target_velocity_now, closing, &behind), speed);
    let change = clamp_norm::<A>(sub::<A>(&wanted, &v), step + max[1]);
    let next = add::<A>(&v, &change);
    let miss = add_scaled::<A>(&d, -dt, &next);
    (next, norm::<A>(&miss) <= 1e-12 + 1e-9 * norm::<A>(&d))
}

/// Returns `v`, scaled down to the norm `max` if it is longer.
#[inline(always)]
fn clamp_norm<A: RealOps<Real = f64>>(v: [f64; 3], max: f64) -> [f64; 3] {
    // Compute the root only if the vector is too long.
    let squared = dot::<A>(&v, &v);
    if squared > max * max { scale::<A>(max / A::sqrt(squared), &v) } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::BaselineF64;

    #[test]
    fn speed_and_acceleration_stay_bounded_and_the_target_is_reached_exactly() {
        let target = Pose { position: [0.3, -0.2, 0.1], rotation: rotation_matrix([0.3, 1.0, -0.4]) };
        let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
        let mut before = [0.0; 6];
        for tick in 0..400 {
            let pose = governor.update::<BaselineF64>(&target, [0.25, 1.0], [1.0, 4.0], 0.01);
            let v = governor.velocity;
            let linear = norm::<BaselineF64>(&[v[0], v[1], v[2]]);
            let angular = norm::<BaselineF64>(&[v[3], v[4], v[5]]);
            assert!(linear <= 0.25 + 1e-12 && angular <= 1.0 + 1e-12, "tick {tick}: {linear} {angular}");
            let change = norm::<BaselineF64>(&[v[0] - before[0], v[1] - before[1], v[2] - before[2]]);
            assert!(change <= 0.01 + 1e-12, "tick {tick}: {change} m/s in one tick");
            before = v;
            if tick == 399 {
                assert_eq!(pose, target);
                assert!(linear < 1e-9 && angular < 1e-9);
            }
        }
    }

    #[test]
    fn a_lowered_speed_limit_acts_at_once_and_a_reached_target_keeps_its_velocity() {
        let far = Pose { position: [5.0, 0.0, 0.0], ..Pose::IDENTITY };
        let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
        for _ in 0..100 {
            governor.update::<BaselineF64>(&far, [1.0, 1.0], [2.0, 4.0], 0.01);
        }
        let before = governor.pose.position[0];
        let after = governor.update::<BaselineF64>(&far, [0.1, 1.0], [2.0, 4.0], 0.01).position[0];
        assert!(after - before <= 0.1 * 0.01 + 1e-15);
        let twist = [0.3, 0.4, 0.0, 0.1, 0.0, 0.0];
        let velocity = governor.velocity(&twist, [0.1, 1.0]);
        assert!((velocity[0] - 0.1).abs() < 1e-12 && velocity[1].abs() < 1e-12 && (velocity[3] - 0.1).abs() < 1e-15);
        assert_eq!(ReferenceGovernor::new(far).velocity(&twist, [0.25, 1.0])[..2], [0.15, 0.2]);
    }

    #[test]
    fn a_slow_target_is_reached_without_overshoot() {
        let at = |t: f64| Pose { position: [0.1 * t.min(1.0), 0.0, 0.0], ..Pose::IDENTITY };
        let (mut governor, mut before) = (ReferenceGovernor::new(Pose::IDENTITY), 0.0);
        for tick in 1..200 {
            let target = at(f64::from(tick) * 0.01);
            let x = governor.update::<BaselineF64>(&target, [0.25, 1.0], [1.0, 4.0], 0.01).position[0];
            assert!(x <= target.position[0] + 1e-12, "tick {tick}: {x}");
            // The reference accelerates within its bound, and brakes as hard as the target, which stops abruptly.
            let change = governor.velocity[0] - before;
            before = governor.velocity[0];
            assert!(change.abs() <= 0.01 + 1e-12 || tick > 100, "tick {tick}: {change} m/s");
            // From rest the reference needs 0.1 s to reach the target's speed, and longer to close the gap.
            assert!(tick < 40 || (x - target.position[0]).abs() < 1e-9, "tick {tick}: {x}");
        }
    }

    #[test]
    fn a_reference_waits_for_a_lagging_arm_but_not_sideways_or_backward() {
        let far = |x: f64, y: f64| Pose { position: [x, y, 0.0], rotation: rotation_matrix([0.0, 0.0, 0.2 * x]) };
        let (speed, lag) = ([0.25, 1.0], [0.02, 0.0, 0.0, 0.0, 0.0, 0.1]);
        let bounds = [speed, [1.0, 4.0]];
        let gone = |target: &Pose, share: f64| {
            let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
            for _ in 0..50 {
                let before = governor.pose;
                governor.update::<BaselineF64>(target, speed, [1.0, 4.0], 0.01);
                governor.hold_back(&before, &lag, share, bounds, 0.01);
            }
            governor
        };
        let waiting = gone(&far(5.0, 0.0), 1.0);
        assert!(
            norm::<BaselineF64>(&waiting.pose.position) < 1e-12
                && pose_error(&Pose::IDENTITY, &waiting.pose)[5].abs() < 1e-12
        );
        assert!(waiting.velocity.iter().all(|v| v.abs() < 1e-9) && waiting.arrived() == [false; 2]);
        let sideways = gone(&far(0.0, 5.0), 1.0).pose.position;
        assert!(sideways[1] > 0.08 && sideways[0].abs() < 1e-12);
        let (free, back) = (gone(&far(-5.0, 0.0), 0.0), gone(&far(-5.0, 0.0), 1.0));
        assert_eq!((free.pose, free.velocity), (back.pose, back.velocity));
        let half = gone(&far(5.0, 0.0), 0.5).pose.position[0];
        assert!(half > 1e-4 && half < 0.5 * -free.pose.position[0]);
    }

    #[test]
    fn a_waiting_reference_brakes_to_rest_within_its_bound() {
        let (far, lag) = (Pose { position: [5.0, 0.0, 0.0], ..Pose::IDENTITY }, [0.02, 0.0, 0.0, 0.0, 0.0, 0.0]);
        for acceleration in [0.05, 1.0, 20.0] {
            let bounds = [[0.25, 1.0], [acceleration, 4.0]];
            let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
            for _ in 0..600 {
                governor.update::<BaselineF64>(&far, bounds[0], bounds[1], 0.01);
            }
            let (from, mut speed) = (governor.pose.position[0], governor.velocity[0]);
            assert!((speed - 0.25).abs() < 1e-12);
            for tick in 0..12 {
                let before = governor.pose;
                governor.update::<BaselineF64>(&far, bounds[0], bounds[1], 0.01);
                governor.hold_back(&before, &lag, 1.0, bounds, 0.01);
                let now = governor.velocity[0];
                let max = (MAX_HOLD_DECELERATION[0] + acceleration) * 0.01 + 1e-12;
                assert!((-1e-12..=max).contains(&(speed - now)), "tick {tick}: {speed} {now}");
                assert!((governor.pose.position[0] - before.position[0] - now * 0.01).abs() < 1e-12);
                speed = now;
            }
            let distance = governor.pose.position[0] - from;
            assert!(
                speed.abs() < 1e-12 && distance < 0.25 * 0.25 / (2.0 * MAX_HOLD_DECELERATION[0]) + 0.0025,
                "{acceleration}: {speed} {distance}"
            );
        }
    }

    #[test]
    fn with_infinite_acceleration_the_reference_starts_at_full_speed_and_stops_at_the_target() {
        let target = Pose { position: [0.1, 0.0, 0.0], ..Pose::IDENTITY };
        let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
        for tick in 1..60 {
            let x = governor.update::<BaselineF64>(&target, [0.25, 1.0], [f64::INFINITY; 2], 0.01).position[0];
            let expected = (0.0025 * f64::from(tick)).min(0.1);
            assert!((x - expected).abs() < 1e-12, "tick {tick}: {x} instead of {expected}");
        }
    }

    #[test]
    fn an_infinite_speed_limit_passes_the_target_through() {
        let target = Pose { position: [3.0, 0.0, 0.0], ..Pose::IDENTITY };
        let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
        assert_eq!(governor.update::<BaselineF64>(&target, [f64::INFINITY; 2], [1.0, 4.0], 0.01), target);
        // With one finite limit, the block without a limit has the velocity zero, also at its target.
        let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
        for tick in 1..4 {
            let target = screw(AXES[2], 1e-4 * f64::from(tick));
            assert_eq!(governor.update::<BaselineF64>(&target, [0.25, f64::INFINITY], [1.0, 4.0], 0.01), target);
            assert!(norm::<BaselineF64>(&[governor.velocity[0], governor.velocity[1], governor.velocity[2]]) > 0.009);
            assert_eq!(governor.velocity[3..], [0.0; 3]);
        }
    }

    /// Returns the rotation vector [rad] of a pose.
    fn turned(pose: &Pose) -> [f64; 3] {
        let e = pose_error(&Pose::IDENTITY, pose);
        [e[3], e[4], e[5]]
    }

    /// Returns the pose displaced by `x` along `axis`, and rotated by `x` about it.
    fn screw(axis: [f64; 3], x: f64) -> Pose {
        let vector = axis.map(|a| a * x);
        Pose { position: vector, rotation: rotation_matrix(vector) }
    }

    const AXES: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, -0.6, 0.8], [0.48, 0.6, -0.64]];

    #[test]
    fn every_axis_and_the_rotation_about_it_follow_one_motion() {
        // A jump, a slow target, a target that stops abruptly, a faster one, and the way back.
        let at = |tick: u32| match tick {
            0..60 => 0.3,
            60..120 => 0.3 + 0.002 * f64::from(tick - 60),
            120..200 => 0.42,
            200..260 => 0.42 + 0.01 * f64::from(tick - 200),
            _ => -0.2,
        };
        let (speed, bounds) = ([0.5; 2], [1.5; 2]);
        let mut first: Vec<f64> = Vec::new();
        for (number, axis) in AXES.into_iter().enumerate() {
            let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
            for tick in 0..500 {
                let pose = governor.update::<BaselineF64>(&screw(axis, at(tick)), speed, bounds, 0.01);
                let [along, about] = [pose.position, turned(&pose)].map(|v| dot::<BaselineF64>(&v, &axis));
                assert!((along - about).abs() < 1e-9, "{axis:?}, tick {tick}: {along} m, {about} rad");
                for (v, size) in [(pose.position, along), (turned(&pose), about)] {
                    assert!((norm::<BaselineF64>(&v) - size.abs()).abs() < 1e-9, "off the axis: {v:?}");
                }
                let index = tick as usize;
                if number == 0 {
                    first.push(along);
                }
                assert!((along - first[index]).abs() < 1e-9, "{axis:?}, tick {tick}: {along} {}", first[index]);
            }
        }
    }

    #[test]
    fn a_reference_at_its_target_moves_as_by_the_general_formula() {
        let (speed, acceleration, dt) = ([0.25, 1.0], [1.0, 4.0], 0.01);
        let mut taken = [false; 2];
        // Speeds of the target along a screw axis: constant, faster, braking abruptly, jumping, and back.
        for (before, now) in [(0.1, 0.1), (0.1, 0.105), (0.1, 0.12), (0.2, 0.0), (0.2, 0.5), (0.1, -0.1)] {
            for axis in AXES {
                let from = screw(axis, 0.0);
                let velocity: [f64; 6] = std::array::from_fn(|i| before * axis[i % 3]);
                let at = ReferenceGovernor { velocity, target_speed: [before; 2], ..ReferenceGovernor::new(from) };
                // This pose differs from the target by rounding, so that the reference uses the general path.
                let mut beside = at;
                beside.pose.position.iter_mut().for_each(|x| *x += 1e-300);
                let target = screw(axis, now * dt);
                let mut quick = at;
                taken
                    [usize::from(quick.follows::<BaselineF64>(&pose_error(&from, &target), speed, acceleration, dt))] =
                    true;
                let [direct, general] = [at, beside].map(|mut governor| {
                    let pose = governor.update::<BaselineF64>(&target, speed, acceleration, dt);
                    (pose_error(&pose, &target), governor.velocity, governor.target_speed, governor.arrived())
                });
                let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
                assert!(close(&direct.0, &general.0), "{before} {now}: {direct:?} {general:?}");
                assert!(close(&direct.1, &general.1) && close(&direct.2, &general.2) && direct.3 == general.3);
            }
        }
        assert_eq!(taken, [true; 2], "targets within and beyond the bounds");
    }

    #[test]
    fn a_target_at_rest_is_reached_in_the_shortest_time() {
        let (speed, acceleration, dt) = (0.5, 2.0, 0.01);
        for distance in [0.001, 0.01, 0.03, 0.1, 0.2, 0.6] {
            // The speed profile is a trapezoid, or a triangle if the distance is too short for the largest speed.
            let shortest = if distance > speed * speed / acceleration {
                distance / speed + speed / acceleration
            } else {
                2.0 * f64::sqrt(distance / acceleration)
            };
            let mut governor = ReferenceGovernor::new(Pose::IDENTITY);
            let target = Pose { position: [distance, 0.0, 0.0], ..Pose::IDENTITY };
            let (mut ticks, mut x) = (0.0, 0.0);
            while x < distance {
                let next = governor.update::<BaselineF64>(&target, [speed; 2], [acceleration; 2], dt).position[0];
                assert!(next > x && next <= distance, "{distance}: {x} {next}");
                (x, ticks) = (next, ticks + 1.0);
            }
            assert!(ticks * dt >= shortest - 2.0 * dt && ticks * dt <= shortest + 4.0 * dt, "{distance}: {ticks}");
        }
    }

    #[test]
    fn a_reference_approaches_at_the_speed_from_which_it_can_stop() {
        let (acceleration, dt) = (2.0, 0.01);
        let step = acceleration * dt;
        // Distances in units of step · dt, and speeds in units of step: braking for p periods, at these speeds less one
        // unit per period, covers the distance.
        for (distance, speed) in
            [(0.4, 0.4), (1.0, 1.0), (1.05, 1.025), (2.0, 1.5), (3.1, 3.1 / 3.0 + 1.0), (9.0, 3.75)]
        {
            let d = [0.0, distance * step * dt, 0.0];
            let v = [0.0, speed * step, 0.0];
            let (next, arrived) = approach::<BaselineF64>(d, v, [0.0; 3], 10.0, [acceleration, 0.0], dt);
            assert!((next[1] / step - speed).abs() < 1e-9, "{distance}: {}", next[1] / step);
            assert_eq!(arrived, distance <= 1.0);
        }
        // A target counts as reached if the reference misses it by rounding errors only.
        for (miss, expected) in [(0.0, true), (1e-13, true), (1e-10, false)] {
            let d = [2e-3 + miss, 0.0, 0.0];
            let (next, arrived) = approach::<BaselineF64>(d, [0.2, 0.0, 0.0], [0.2, 0.0, 0.0], 0.2, [2.0, 0.0], dt);
            assert!((next[0] - 0.2).abs() < 1e-7 && arrived == expected, "{miss}: {next:?} {arrived}");
        }
    }

    #[test]
    fn a_held_reference_loses_its_share_of_the_motion_along_the_lag_only() {
        let (far, dt) = (screw([0.0, 1.0, 0.0], 1.0), 0.01);
        let (moved, lag) = ([1e-4, 2e-4, -1e-4], [0.02, 0.02, 0.01]);
        let gained = (1e-4 * 0.02 + 2e-4 * 0.02 - 1e-4 * 0.01) / 0.0009;
        for share in [0.25, 1.0] {
            // The length of the lag has no effect, only its direction.
            for scale in [1.0, 7.0] {
                for acceleration in [0.1, 100.0] {
                    let pose = Pose { position: moved, rotation: rotation_matrix(moved) };
                    let mut governor = ReferenceGovernor { target: far, ..ReferenceGovernor::new(pose) };
                    let velocity: [f64; 6] = std::array::from_fn(|i| moved[i % 3] / dt);
                    governor.velocity = velocity;
                    let both: [f64; 6] = std::array::from_fn(|i| scale * lag[i % 3]);
                    governor.hold_back(&Pose::IDENTITY, &both, share, [[0.5; 2], [acceleration; 2]], dt);
                    let got = [governor.pose.position, turned(&governor.pose)];
                    for (block, deceleration) in [3.0, 12.0].into_iter().enumerate() {
                        // Motion that is undone, as a multiple of the lag, whose length is 0.03.
                        let taken = f64::min(share * gained, (deceleration + acceleration) * dt * dt / 0.03);
                        for i in 0..3 {
                            let expected = moved[i] - taken * lag[i];
                            assert!((got[block][i] - expected).abs() < 1e-12, "{share} {scale} {block}: {got:?}");
                            let velocity = governor.velocity[3 * block + i];
                            assert!((velocity - expected / dt).abs() < 1e-10, "{velocity}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_lag_whose_square_underflows_holds_nothing_back() {
        let moved = Pose { position: [1e-3, 0.0, 0.0], ..Pose::IDENTITY };
        let far = Pose { position: [1.0, 0.0, 0.0], ..Pose::IDENTITY };
        for lag in [1e-170, 1e-155] {
            let mut governor = ReferenceGovernor { target: far, ..ReferenceGovernor::new(moved) };
            governor.hold_back(&Pose::IDENTITY, &[lag, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, [[0.5; 2], [1.0; 2]], 0.01);
            assert_eq!(governor.pose, moved);
        }
    }

    #[test]
    fn a_reference_is_held_only_if_its_target_is_far() {
        let finite = [0.5, 1.0];
        for axis in AXES {
            for sign in [-1.0, 1.0] {
                let lags = |metres: f64, radians: f64, speed: [f64; 2]| {
                    let start = Pose { position: [0.3, -0.2, 0.1], rotation: rotation_matrix([0.4, -0.5, 0.9]) };
                    let turn = rotation_matrix(axis.map(|a| sign * radians * a));
                    let target = Pose {
                        position: std::array::from_fn(|i| start.position[i] + sign * metres * axis[i]),
                        rotation: multiply::<BaselineF64>(&turn, &start.rotation),
                    };
                    ReferenceGovernor { target, ..ReferenceGovernor::new(start) }.lags(speed)
                };
                assert_eq!(lags(0.0499, 0.199, finite), [false, false]);
                assert_eq!(lags(0.0501, 0.199, finite), [true, false]);
                assert_eq!(lags(0.0499, 0.201, finite), [false, true]);
                assert_eq!(lags(1.0, 1.0, [0.5, f64::INFINITY]), [true, false]);
                assert_eq!(lags(1.0, 1.0, [f64::INFINITY, 1.0]), [false, true]);
            }
        }
        for (share, held) in [(1.0, 0.0), (0.9, 0.5), (0.8, 1.0), (0.0, 1.0)] {
            assert!((hold_fraction(share) - held).abs() < 1e-15, "{share}");
        }
    }

    #[test]
    fn position_and_rotation_arrive_each_for_itself() {
        let twist = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
        let velocity = [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0];
        for (target, expected) in [
            (Pose::IDENTITY, twist),
            (Pose { position: [0.0, 0.0, 1e-300], ..Pose::IDENTITY }, [-1.0, -2.0, -3.0, 0.4, 0.5, 0.6]),
            (Pose { rotation: rotation_matrix([0.0, 0.0, 1e-9]), ..Pose::IDENTITY }, [0.1, 0.2, 0.3, -4.0, -5.0, -6.0]),
            (screw([0.0, 1.0, 0.0], 0.1), velocity),
        ] {
            let governor = ReferenceGovernor { velocity, target, ..ReferenceGovernor::new(Pose::IDENTITY) };
            assert_eq!(governor.velocity(&twist, [10.0; 2]).map(f64::to_bits), expected.map(f64::to_bits));
        }
        // Each block of the twist is bounded by its own speed.
        let governor = ReferenceGovernor::new(Pose::IDENTITY);
        let bounded = governor.velocity(&[0.0, 3.0, 4.0, 6.0, 0.0, 8.0], [2.5, 20.0]);
        assert!(bounded.iter().zip([0.0, 1.5, 2.0, 6.0, 0.0, 8.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{bounded:?}");
    }
}
