//! Filter that rejects implausible joint positions, such as late replies of servos and jumps of an encoder.

use crate::error::{Error, Result};

/// Ratio of the largest plausible speed of a joint, which a hand may push, to its speed limit.
const PUSHED_SPEED: f64 = 2.0;
/// Change of position that is accepted between two readings, however short the time between them [rad].
const JUMP_MARGIN: f64 = 0.2;
/// Gap between two readings above which the accepted change grows even after an implausible position [s]: the joint may
/// have moved in the gap.
const READING_GAP: f64 = 0.1;

/// Filter of the positions of N joints; [`PositionFilter::update`] is called once per reading.
///
/// A position is accepted if it was read, is finite, and lies within `2 v_max Δt + 0.2 rad` of the last accepted
/// position of the joint; v_max is its largest speed [rad/s], Δt the time since that position [s]. After an implausible
/// position, only gaps of more than 0.1 s between readings count as part of Δt, so that a lasting jump of an encoder
/// stays rejected. The first position of a joint is always accepted.
#[derive(Debug, Clone)]
pub struct PositionFilter {
    max_speed: Vec<f64>,
    position: Vec<f64>,
    time: Vec<f64>,
    jumps: u64,
    accepted: Vec<bool>,
    /// Times of the last readings [s], accepted or not.
    last: Vec<f64>,
    /// Δt of each joint (see [`PositionFilter`]) at its last reading [s].
    elapsed: Vec<f64>,
    rejected: Vec<u32>,
    jump: Vec<f64>,
}

impl PositionFilter {
    /// Creates a filter without positions from the largest speed of each of the N joints [rad/s].
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if a speed is not finite or negative.
    pub fn new(max_speed: &[f64]) -> Result<Self> {
        if let Some(i) = max_speed.iter().position(|speed| !(*speed >= 0.0 && speed.is_finite())) {
            return Err(Error::out_of_range(format!("max_speed[{i}]"), max_speed[i], "[0, ∞) rad/s"));
        }
        let n = max_speed.len();
        let mut filter = Self {
            max_speed: max_speed.to_vec(),
            position: vec![0.0; n],
            time: vec![0.0; n],
            jumps: 0,
            accepted: vec![false; n],
            last: vec![0.0; n],
            elapsed: vec![0.0; n],
            rejected: vec![0; n],
            jump: vec![0.0; n],
        };
        filter.reset();
        Ok(filter)
    }

    /// Discards all positions: the next position of each joint is accepted in any case.
    pub fn reset(&mut self) {
        self.position.fill(f64::NAN);
        self.time.fill(f64::NEG_INFINITY);
        self.last.fill(f64::NEG_INFINITY);
        self.elapsed.fill(0.0);
        self.jump.fill(0.0);
        self.rejected.fill(0);
    }

    /// Returns the last accepted position of each joint [rad]; NaN before the first.
    pub fn position(&self) -> &[f64] {
        &self.position
    }

    /// Returns the time at which the last accepted position of each joint was sampled [s]; −∞ before the first.
    pub fn time(&self) -> &[f64] {
        &self.time
    }

    /// Returns, for each joint, true if the last [`Self::update`] has accepted its position.
    pub fn accepted(&self) -> &[bool] {
        &self.accepted
    }

    /// Returns the number of positions of all joints that were rejected so far as too far from the last accepted one.
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    /// Returns the number of implausible positions of each joint since its last accepted one.
    pub fn rejected(&self) -> &[u32] {
        &self.rejected
    }

    /// Returns the distance of each joint's latest implausible position from the accepted one [rad]; 0 before the
    /// first.
    pub fn jump(&self) -> &[f64] {
        &self.jump
    }

    /// Stores an assumed position [rad] at `time` [s] for each of the N joints that has not been read yet. The first
    /// reading of a joint replaces its assumed position, however far it lies from it.
    pub fn assume(&mut self, position: &[f64], time: f64) {
        for i in 0..self.max_speed.len().min(position.len()) {
            if self.last[i] == f64::NEG_INFINITY {
                (self.position[i], self.time[i]) = (position[i], time);
            }
        }
    }

    /// Checks the positions [rad] of the N joints in a reading and stores the plausible ones. Returns, for each joint,
    /// true if its position was stored.
    ///
    /// `ok` is true for the joints that were read in this cycle; `time` is the sample time of each joint [s]. Joints
    /// beyond the shortest of the slices count as not read.
    pub fn update(&mut self, position: &[f64], ok: &[bool], time: &[f64]) -> &[bool] {
        self.accepted.fill(false);
        let n = self.max_speed.len().min(position.len()).min(ok.len()).min(time.len());
        for i in 0..n {
            if !(ok[i] && position[i].is_finite()) {
                continue;
            }
            let is_first = self.last[i] == f64::NEG_INFINITY;
            let gap = if is_first { 0.0 } else { time[i] - self.last[i] };
            self.last[i] = time[i];
            if self.rejected[i] == 0 || gap > READING_GAP {
                self.elapsed[i] += gap;
            }
            let distance = (position[i] - self.position[i]).abs();
            let reach = (PUSHED_SPEED * self.max_speed[i]).mul_add(self.elapsed[i], JUMP_MARGIN);
            if is_first || distance <= reach {
                self.accepted[i] = true;
                (self.position[i], self.time[i]) = (position[i], time[i]);
                (self.elapsed[i], self.rejected[i]) = (0.0, 0);
            } else {
                self.jumps += 1;
                self.jump[i] = distance;
                self.rejected[i] = self.rejected[i].saturating_add(1);
            }
        }
        &self.accepted
    }
}
