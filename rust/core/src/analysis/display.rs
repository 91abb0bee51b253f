//! The report as sentences and as a table.

use std::fmt::{self, Write as _};

use crate::analysis::check::{FeasibilityReport, Issue, NEAR_SINGULAR};
use crate::analysis::report::PoseReport;
use crate::command::host_loss::TRAVEL;
use crate::params::{Law, OnDeviationLimit};

const SIDES: [&str; 2] = ["−", "+"];

/// Returns the unit of a strength along an axis.
pub(super) fn unit(axis: usize) -> &'static str {
    if axis < 3 { "N" } else { "N·m" }
}

/// Formats a displacement along an axis.
pub(super) fn length(axis: usize, value: f64) -> String {
    if axis < 3 { format!("{:.0} mm", 1e3 * value) } else { format!("{} rad", number(value)) }
}

/// Formats a number with two or three digits.
pub(super) fn number(value: f64) -> String {
    match value.abs() {
        size if size.is_infinite() => "∞".into(),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 0.995 || size == 0.0 => format!("{value:.1}"),
        size if size >= 0.0995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

impl PoseReport {
    /// Returns one sentence for each axis, and one for each problem.
    pub fn summary(&self) -> Vec<String> {
        let mut out = Vec::new();
        for row in 0..self.axes.len() {
            let said = [0, 1].map(|side| self.axis_sentence(row, side));
            if said[0] == said[1] {
                out.push(format!("±{} {}", self.axes[row], said[0]));
            } else {
                out.extend([1, 0].map(|side| format!("{}{} {}", SIDES[side], self.axes[row], said[side])));
            }
            out.extend([1, 0].into_iter().filter_map(|side| self.stop_sentence(row, side)));
            out.extend([1, 0].into_iter().filter_map(|side| self.path_sentence(row, side)));
            out.extend(self.deviation_sentence(row));
            if let (hold, Some(default)) = self.hold[row] {
                out.push(format!(
                    "{}: hold is {} {unit} instead of {}, to leave room for soft and firm.",
                    self.axes[row],
                    number(hold),
                    number(default),
                    unit = self.unit(row)
                ));
            }
        }
        for (i, name) in self.joints.iter().enumerate() {
            let least = self.gravity_margin[i][0].min(self.gravity_margin[i][1]);
            if least < 0.0 {
                out.push(format!("joint {name} cannot hold its load: its limit is {} N·m short.", number(-least)));
            }
        }
        self.joint_sentence(&self.saturated, "at the servo's ceiling", &mut out);
        self.joint_sentence(&self.locked, "at a position limit, so that the others do their part", &mut out);
        if self.sigma_min < NEAR_SINGULAR * self.sigma_0 {
            out.push(format!(
                "This is near a singular pose: σ_min is {}, condition {:.0}.",
                number(self.sigma_min),
                self.condition
            ));
        }
        for (factor, what) in [(self.gain_factor, "stiffness"), (self.damping_factor, "damping")] {
            if factor < 1.0 - 1e-9 {
                out.push(format!(
                    "Delay and rate allow {} of the {what} that was asked for, here and now.",
                    number(factor)
                ));
            }
        }
        let (mut meets, mut fixed) = (Vec::new(), Vec::new());
        for (row, axis) in self.axes.iter().enumerate() {
            for side in [1, 0] {
                let (sign, force) = (SIDES[side], self.host_loss_force[row][side]);
                if force.is_finite() {
                    meets.push(format!("{sign}{axis} {} {}", number(force), self.unit(row)));
                } else {
                    fixed.push(format!("{sign}{axis}"));
                }
            }
        }
        let mut dies = "After a host loss now, the servos keep their goals and limits".to_owned();
        if !meets.is_empty() {
            let _ = write!(
                dies,
                ": a hand that moves the tool by {} mm or {} rad from there meets at most {}",
                1e3 * TRAVEL[0],
                TRAVEL[1],
                meets.join(", ")
            );
        }
        if !fixed.is_empty() {
            let _ = write!(
                dies,
                "; it cannot move it so far along {}: the arm is stretched out or at a stop",
                fixed.join(", ")
            );
        }
        out.push(dies + ".");
        out.extend(self.host_loss_sentence());
        out
    }

    /// Sentence for a host-loss force above the allowed one, because the limits must hold the arm.
    fn host_loss_sentence(&self) -> Option<String> {
        let max = self.max_host_loss_force?;
        let above = |row: usize, side: usize| {
            let force = self.host_loss_force[row][side];
            let over = self.unit(row) == "N" && force.is_finite() && force > max * (1.0 + 1e-9);
            over.then(|| format!("{}{} {} N", SIDES[side], self.axes[row], number(force)))
        };
        let over: Vec<String> =
            (0..self.axes.len()).flat_map(|row| [1, 0].into_iter().filter_map(move |side| above(row, side))).collect();
        (!over.is_empty()).then(|| {
            let (max, over) = (number(max), over.join(", "));
            format!("torque_limits.max_host_loss_force is {max} N, but limits that just hold the arm leave {over}.")
        })
    }

    fn unit(&self, row: usize) -> &'static str {
        if matches!(self.axes[row], "x" | "y" | "z") { "N" } else { "N·m" }
    }

    fn axis_sentence(&self, row: usize, side: usize) -> String {
        let (unit, [small, large]) = (self.unit(row), self.gives_way[row][side]);
        let translation = unit == "N";
        let at = |d: f64| length(if translation { 0 } else { 3 }, d);
        if large < 0.0 && small < 0.0 {
            return format!("cannot hold itself: it lacks {} {unit}.", number(-large));
        }
        let mut said = Vec::new();
        if self.yields[row][side] {
            let friction = format!("(friction: {} {unit})", number(self.friction[row]));
            said.push(if (small - large).abs() > 0.02 * small.abs().max(large.abs()) {
                let far = at(self.thresholds[row][1].min(TRAVEL[usize::from(!translation)]));
                format!("gives way at {} {unit}, at {} {unit} from {far} on {friction}", number(small), number(large))
            } else {
                format!("gives way at {} {unit} {friction}", number(small))
            });
            let (least, held) = match (self.law, self.coupled_to[row][side]) {
                (Law::Paper, Some(other)) => (self.coupling[row][side].max(0.0), format!(" while {other} is held")),
                (Law::Paper, None) => (self.coupling[row][side].max(0.0), String::new()),
                _ => (self.friction_left[row], String::new()),
            };
            said.push(format!("cannot be softer than {} {unit}{held}", number(least)));
        } else {
            said.push(format!("holds up to {} {unit}", number(large)));
        }
        if large >= 0.999 * self.capacity[row][side] {
            said.push("there the servos' torque ends".into());
        }
        said.join("; ") + "."
    }

    /// Sentence for a position limit that stops a push along a yielding axis.
    fn stop_sentence(&self, row: usize, side: usize) -> Option<String> {
        let joint = self.stop_joint[row][side].filter(|_| self.yields[row][side])?;
        let (unit, room, distance) = (self.unit(row), self.stop_room[row][side], self.stop_distance[row][side]);
        let from = if room > 1e-6 {
            let away = if self.prismatic[joint] {
                format!("{:.0} mm", 1e3 * room)
            } else {
                format!("{:.1}°", room.to_degrees())
            };
            format!("is {away} from its limit: pushed farther than")
        } else {
            "is at its limit: pushed farther than".into()
        };
        let far = length(if unit == "N" { 0 } else { 3 }, distance);
        let then = match self.stop_friction[row][side] {
            rub if rub.is_infinite() => "the stop takes what exceeds the cap".into(),
            rub => format!("the stop takes its part and the other joints add {} {unit} of friction", number(rub)),
        };
        Some(format!("{}{}: {} {from} {far}, {then}.", SIDES[side], self.axes[row], self.joints[joint]))
    }

    /// Sentence for a singular pose that a push along a yielding axis reaches.
    fn path_sentence(&self, row: usize, side: usize) -> Option<String> {
        let (sigma, far) = (self.way_sigma[row][side], self.way_distance[row][side]);
        let near = self.yields[row][side] && far > 0.0 && sigma < NEAR_SINGULAR * self.sigma_0;
        near.then(|| {
            let unit = self.unit(row);
            format!(
                "{}{}: pushed by {} the arm is near a singular pose: σ_min is {} instead of {}, and joint friction is {} {unit}.",
                SIDES[side],
                self.axes[row],
                length(if unit == "N" { 0 } else { 3 }, far),
                number(sigma),
                number(self.sigma_min),
                number(self.way_friction[row][side])
            )
        })
    }

    /// Sentence for the behaviour of the target beyond the deviation limit.
    fn deviation_sentence(&self, row: usize) -> Option<String> {
        let [minus, plus] = self.deviation_limit[row];
        let limit = minus.min(plus);
        let side = match (minus.is_finite(), plus.is_finite()) {
            (true, true) => "±",
            (true, false) => SIDES[0],
            (false, true) => SIDES[1],
            (false, false) => return None,
        };
        let does = match self.on_deviation_limit[row] {
            OnDeviationLimit::Wait => "the whole target waits",
            OnDeviationLimit::Yield => "its target comes along",
        };
        let far = length(if self.unit(row) == "N" { 0 } else { 3 }, limit);
        Some(format!("{side}{}: pushed farther than {far} off its target, {does}.", self.axes[row]))
    }

    fn joint_sentence(&self, flags: &[bool], what: &str, out: &mut Vec<String>) {
        let named: Vec<&str> =
            self.joints.iter().zip(flags).filter(|(_, on)| **on).map(|(name, _)| name.as_str()).collect();
        if !named.is_empty() {
            out.push(format!("Now {what}: {}.", named.join(", ")));
        }
    }
}

impl fmt::Display for PoseReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "axis      gives way    held by limits   torque ends   host loss   friction left  unit")?;
        for (row, axis) in self.axes.iter().enumerate() {
            for side in [1, 0] {
                let [small, large] = self.gives_way[row][side].map(number);
                writeln!(
                    f,
                    "{:<7}{:>5} … {:<6}{:>12}{:>14}{:>14}{:>10} {:<6}{:<4}",
                    format!("{}{axis}", SIDES[side]),
                    small,
                    large,
                    number(self.static_force[row][side]),
                    number(self.capacity[row][side]),
                    number(self.host_loss_force[row][side]),
                    number(self.friction[row]),
                    number(self.friction_left[row]),
                    self.unit(row)
                )?;
            }
        }
        for sentence in self.summary() {
            writeln!(f, "{sentence}")?;
        }
        Ok(())
    }
}

impl fmt::Display for FeasibilityReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.achievable { "achievable" } else { "not achievable" };
        write!(f, "{verdict} in {} {}", self.poses, if self.poses == 1 { "pose" } else { "poses" })?;
        for finding in &self.findings {
            write!(f, "\n{finding}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Issue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let weight = if self.required { "" } else { "note: " };
        write!(f, "{weight}{} at pose {}: {}", self.about, self.pose, self.reason)?;
        match (&self.setting, self.value) {
            (Some(setting), Some(value)) => write!(f, "; nearest that works: {setting}={value}"),
            (Some(setting), None) => write!(f, "; change {setting}"),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rounding::{round_down, round_up};

    #[test]
    fn numbers_are_rounded_to_the_safe_side() {
        for (value, down, up) in [(4.567, 4.5, 4.6), (0.3, 0.3, 0.3), (123.0, 120.0, 130.0), (0.0123, 0.012, 0.013)] {
            assert!((round_down(value) - down).abs() < 1e-12 && (round_up(value) - up).abs() < 1e-12, "{value}");
        }
        assert_eq!(number(4.66), "4.7");
        assert_eq!(number(f64::INFINITY), "∞");
    }
}
