//! The true tool speed limit: a target that moves at most so fast.

use crate::pose::Pose;
use crate::task::deviation::{pose_error, rotation_matrix};

/// Reference pose between the start and the target, with its velocity; bounded in speed and acceleration.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Governor {
    pose: Pose,
    /// Linear [m/s] and angular [rad/s], base axes.
    velocity: [f64; 6],
}

impl Governor {
    /// At rest in `pose`.
    pub(crate) fn new(pose: Pose) -> Self {
        Self { pose, velocity: [0.0; 6] }
    }

    /// Velocity of the reference (6,), base axes.
    pub(crate) fn velocity(&self) -> &[f64; 6] {
        &self.velocity
    }

    /// Moves the reference toward `target` for `dt` [s] and returns it.
    ///
    /// Each of translation and rotation brakes so that it can stop at the target: v ≤ √(2 a d). An infinite speed hands
    /// the target through.
    pub(crate) fn follow(&mut self, target: &Pose, speed: [f64; 2], acceleration: [f64; 2], dt: f64) -> Pose {
        let e = pose_error(&self.pose, target);
        let (linear, at_position) = approach([e[0], e[1], e[2]], self.part(0), speed[0], acceleration[0], dt);
        let (angular, at_rotation) = approach([e[3], e[4], e[5]], self.part(3), speed[1], acceleration[1], dt);
        if at_position {
            self.pose.position = target.position;
        } else {
            for i in 0..3 {
                self.pose.position[i] += linear[i] * dt;
            }
        }
        if at_rotation {
            self.pose.rotation = target.rotation;
        } else {
            let turn = rotation_matrix(angular.map(|w| w * dt));
            self.pose.rotation = orthonormal(&multiply(&turn, &self.pose.rotation));
        }
        self.velocity = [linear[0], linear[1], linear[2], angular[0], angular[1], angular[2]];
        self.pose
    }

    fn part(&self, from: usize) -> [f64; 3] {
        [self.velocity[from], self.velocity[from + 1], self.velocity[from + 2]]
    }
}

/// Velocity of the next period toward a point at distance `d`, and whether the point is reached in it.
fn approach(d: [f64; 3], v: [f64; 3], speed: f64, acceleration: f64, dt: f64) -> ([f64; 3], bool) {
    let distance = norm(d);
    if !speed.is_finite() {
        return (d.map(|x| x / dt), true);
    }
    // The speed from which a braking of `acceleration` per period ends exactly at the point: the discrete √(2 a d).
    let step = acceleration * dt;
    let braking = 0.5 * step * ((1.0 + 8.0 * distance / (step * dt)).sqrt() - 1.0);
    let wanted = speed.min(braking).min(distance / dt);
    let direction = if distance > 0.0 { d.map(|x| x / distance) } else { [0.0; 3] };
    let change = [0, 1, 2].map(|i| wanted * direction[i] - v[i]);
    let size = norm(change);
    let share = if size > step { step / size } else { 1.0 };
    let next = [0, 1, 2].map(|i| v[i] + share * change[i]);
    let miss = [0, 1, 2].map(|i| d[i] - next[i] * dt);
    (next, norm(miss) <= 1e-12 + 1e-9 * distance)
}

fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

fn multiply(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let mut out = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
        }
    }
    out
}

/// One step of the iteration `R (3 I − RᵀR) / 2`, which keeps a product of many rotations a rotation.
fn orthonormal(r: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let mut correction = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            let dot = r[0][i] * r[0][j] + r[1][i] * r[1][j] + r[2][i] * r[2][j];
            correction[i][j] = if i == j { 1.5 - 0.5 * dot } else { -0.5 * dot };
        }
    }
    multiply(r, &correction)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_and_acceleration_stay_bounded_and_the_target_is_reached_exactly() {
        let target = Pose { position: [0.3, -0.2, 0.1], rotation: rotation_matrix([0.3, 1.0, -0.4]) };
        let mut governor = Governor::new(Pose::IDENTITY);
        let mut before = [0.0; 6];
        for tick in 0..400 {
            let pose = governor.follow(&target, [0.25, 1.0], [1.0, 4.0], 0.01);
            let v = *governor.velocity();
            let linear = norm([v[0], v[1], v[2]]);
            let angular = norm([v[3], v[4], v[5]]);
            assert!(linear <= 0.25 + 1e-12 && angular <= 1.0 + 1e-12, "tick {tick}: {linear} {angular}");
            let jerk = norm([v[0] - before[0], v[1] - before[1], v[2] - before[2]]);
            assert!(jerk <= 0.01 + 1e-12, "tick {tick}: {jerk}");
            before = v;
            if tick == 399 {
                assert_eq!(pose, target);
                assert!(linear < 1e-9 && angular < 1e-9);
            }
        }
    }

    #[test]
    fn an_infinite_speed_hands_the_target_through() {
        let target = Pose { position: [3.0, 0.0, 0.0], ..Pose::IDENTITY };
        let mut governor = Governor::new(Pose::IDENTITY);
        assert_eq!(governor.follow(&target, [f64::INFINITY; 2], [1.0, 4.0], 0.01), target);
    }
}
