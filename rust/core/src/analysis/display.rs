//! Formats reports and issues as sentences, and a pose report also as a table.

use std::fmt::{self, Write as _};

use crate::analysis::check::{FeasibilityReport, Issue, NEAR_SINGULAR};
use crate::analysis::report::{AxisReport, PoseReport};
use crate::command::host_loss::TRAVEL;
use crate::params::{Law, OnDeviationLimit};

const SIDES: [&str; 2] = ["−", "+"];

/// Returns the unit of a strength along task axis `axis` (0 to 5, translations first).
pub(super) fn unit(axis: usize) -> &'static str {
    if axis < 3 { "N" } else { "N·m" }
}

/// Formats a displacement along task axis `axis`: in mm for translations (0 to 2), in rad for rotations (3 to 5).
pub(super) fn displacement(axis: usize, value: f64) -> String {
    if axis < 3 { format!("{:.0} mm", 1e3 * value) } else { format!("{} rad", number(value)) }
}

/// Formats a number: three decimals below 0.1, two below 1, one below 100, else none; `∞` for infinities.
pub(super) fn number(value: f64) -> String {
    match value.abs() {
        size if size.is_infinite() => "∞".into(),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 0.995 || size == 0.0 => format!("{value:.1}"),
        size if size >= 0.0995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

impl AxisReport {
    fn is_translation(&self) -> bool {
        matches!(self.name, "x" | "y" | "z")
    }

    fn unit(&self) -> &'static str {
        if self.is_translation() { "N" } else { "N·m" }
    }

    fn formatted_displacement(&self, value: f64) -> String {
        displacement(if self.is_translation() { 0 } else { 3 }, value)
    }

    /// Appends the sentences about this axis to `out`; if both sides have the same strength, one sentence for both.
    fn summary(&self, report: &PoseReport, out: &mut Vec<String>) {
        let sentences = [0, 1].map(|side| self.strength_sentence(report, side));
        if sentences[0] == sentences[1] {
            out.push(format!("±{} {}", self.name, sentences[0]));
        } else {
            out.extend([1, 0].map(|side| format!("{}{} {}", SIDES[side], self.name, sentences[side])));
        }
        out.extend([1, 0].into_iter().filter_map(|side| self.stop_sentence(report, side)));
        out.extend([1, 0].into_iter().filter_map(|side| self.path_sentence(report, side)));
        out.extend(self.deviation_sentence());
        if let Some(default) = self.default_hold {
            out.push(format!(
                "{}: hold is {} {unit} instead of {}, to leave room for soft and firm.",
                self.name,
                number(self.hold),
                number(default),
                unit = self.unit()
            ));
        }
    }

    fn strength_sentence(&self, report: &PoseReport, side: usize) -> String {
        let (unit, [small, large]) = (self.unit(), self.yield_force[side]);
        if large < 0.0 && small < 0.0 {
            return format!("cannot hold itself: it lacks {} {unit}.", number(-large));
        }
        let mut clauses = Vec::new();
        if self.yields[side] {
            let friction = format!("(friction: {} {unit})", number(self.friction));
            clauses.push(if (small - large).abs() > 0.02 * small.abs().max(large.abs()) {
                let far =
                    self.formatted_displacement(self.thresholds[1].min(TRAVEL[usize::from(!self.is_translation())]));
                format!("gives way at {} {unit}, at {} {unit} from {far} on {friction}", number(small), number(large))
            } else {
                format!("gives way at {} {unit} {friction}", number(small))
            });
            let (min_soft, condition) = match (report.law, self.coupled_to[side]) {
                (Law::Paper, Some(other)) => (self.coupling[side].max(0.0), format!(" while {other} is held")),
                (Law::Paper, None) => (self.coupling[side].max(0.0), String::new()),
                _ => (self.friction_left, String::new()),
            };
            clauses.push(format!("cannot be softer than {} {unit}{condition}", number(min_soft)));
        } else {
            clauses.push(format!("holds up to {} {unit}", number(large)));
        }
        if large >= 0.999 * self.capacity[side] {
            clauses.push("there the servos' torque ends".into());
        }
        clauses.join("; ") + "."
    }

    /// Returns a sentence about the position limit that stops a push toward `side`; `None` if there is no such limit,
    /// or if the side does not yield.
    fn stop_sentence(&self, report: &PoseReport, side: usize) -> Option<String> {
        let stop = self.stop[side].filter(|_| self.yields[side])?;
        let from = if stop.margin > 1e-6 {
            let away = if report.prismatic[stop.joint] {
                format!("{:.0} mm", 1e3 * stop.margin)
            } else {
                format!("{:.1}°", stop.margin.to_degrees())
            };
            format!("is {away} from its limit: pushed farther than")
        } else {
            "is at its limit: pushed farther than".into()
        };
        let then = if stop.friction.is_infinite() {
            "the stop takes what exceeds the cap".into()
        } else {
            let (friction, unit) = (number(stop.friction), self.unit());
            format!("the stop takes part of the force and the other joints add {friction} {unit} of friction")
        };
        let (joint, distance) = (&report.joints[stop.joint], self.formatted_displacement(stop.distance));
        Some(format!("{}{}: {joint} {from} {distance}, {then}.", SIDES[side], self.name))
    }

    /// Returns a sentence about the singular pose that a push toward `side` approaches; `None` if there is no such
    /// pose, or if the side does not yield.
    fn path_sentence(&self, report: &PoseReport, side: usize) -> Option<String> {
        let (sigma, distance) = (self.path_sigma[side], self.path_distance[side]);
        let near = self.yields[side] && distance > 0.0 && sigma < NEAR_SINGULAR * report.sigma_0;
        near.then(|| {
            format!(
                "{}{}: pushed by {} the arm is near a singular pose: σ_min is {} instead of {}, and joint friction is {} {}.",
                SIDES[side],
                self.name,
                self.formatted_displacement(distance),
                number(sigma),
                number(report.sigma_min),
                number(self.path_friction[side]),
                self.unit()
            )
        })
    }

    /// Returns a sentence about the behaviour of the target beyond the deviation limit; `None` without a limit.
    fn deviation_sentence(&self) -> Option<String> {
        let [minus, plus] = self.deviation_limit;
        let side = match (minus.is_finite(), plus.is_finite()) {
            (true, true) => "±",
            (true, false) => SIDES[0],
            (false, true) => SIDES[1],
            (false, false) => return None,
        };
        let reaction = match self.on_deviation_limit {
            OnDeviationLimit::Wait => "the whole target waits",
            OnDeviationLimit::Yield => "its target follows the tool",
        };
        let far = self.formatted_displacement(minus.min(plus));
        Some(format!("{side}{}: pushed farther than {far} off its target, {reaction}.", self.name))
    }
}

impl PoseReport {
    /// Returns one sentence per axis on its strength, one per problem, and one on the forces after a host loss.
    pub fn summary(&self) -> Vec<String> {
        let mut out = Vec::new();
        for axis in &self.axes {
            axis.summary(self, &mut out);
        }
        for (name, margins) in self.joints.iter().zip(&self.gravity_margin) {
            let margin = margins[0].min(margins[1]);
            if margin < 0.0 {
                out.push(format!("joint {name} cannot hold its load: its limit is {} N·m short.", number(-margin)));
            }
        }
        self.joint_sentence(&self.saturated, "at the servo's ceiling", &mut out);
        self.joint_sentence(
            &self.locked,
            "at a position limit, so that the other joints take over their motion",
            &mut out,
        );
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
                    "In this state, delay and rate allow only {} of the requested {what}.",
                    number(factor)
                ));
            }
        }
        out.push(self.host_loss_sentence());
        out.extend(self.host_loss_above_bound());
        out
    }

    /// Iterates over both sides of each axis, + first; yields the axis, the sign as text and the force after a host
    /// loss.
    fn host_loss_forces(&self) -> impl Iterator<Item = (&AxisReport, &'static str, f64)> {
        self.axes.iter().flat_map(|axis| [1, 0].map(|side| (axis, SIDES[side], axis.host_loss_force[side])))
    }

    fn host_loss_sentence(&self) -> String {
        let (mut finite_forces, mut blocked_sides) = (Vec::new(), Vec::new());
        for (axis, sign, force) in self.host_loss_forces() {
            if force.is_finite() {
                finite_forces.push(format!("{sign}{} {} {}", axis.name, number(force), axis.unit()));
            } else {
                blocked_sides.push(format!("{sign}{}", axis.name));
            }
        }
        let mut sentence = "After a host loss now, the servos keep their goals and limits".to_owned();
        if !finite_forces.is_empty() {
            let _ = write!(
                sentence,
                ": a hand that moves the tool by {} mm or {} rad from there meets at most {}",
                1e3 * TRAVEL[0],
                TRAVEL[1],
                finite_forces.join(", ")
            );
        }
        if !blocked_sides.is_empty() {
            let _ = write!(
                sentence,
                "; a hand cannot move the tool that far along {}: the arm is stretched out or at a stop",
                blocked_sides.join(", ")
            );
        }
        sentence + "."
    }

    /// Returns a sentence about host-loss forces above their bound; `None` if there are none. The torque limits cannot
    /// be lower, because they hold the arm.
    fn host_loss_above_bound(&self) -> Option<String> {
        let max = self.max_host_loss_force?;
        let over: Vec<String> = self
            .host_loss_forces()
            .filter(|(axis, _, force)| axis.is_translation() && force.is_finite() && *force > max * (1.0 + 1e-9))
            .map(|(axis, sign, force)| format!("{sign}{} {} N", axis.name, number(force)))
            .collect();
        (!over.is_empty()).then(|| {
            let (max, over) = (number(max), over.join(", "));
            format!("torque_limits.max_host_loss_force is {max} N, but limits that just hold the arm leave {over}.")
        })
    }

    fn joint_sentence(&self, flags: &[bool], what: &str, out: &mut Vec<String>) {
        let names: Vec<&str> =
            self.joints.iter().zip(flags).filter(|(_, on)| **on).map(|(name, _)| name.as_str()).collect();
        if !names.is_empty() {
            out.push(format!("Now {what}: {}.", names.join(", ")));
        }
    }
}

impl fmt::Display for PoseReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "axis      gives way   limits hold   servos hold     host loss  friction left  unit")?;
        for axis in &self.axes {
            for side in [1, 0] {
                let [small, large] = axis.yield_force[side].map(number);
                writeln!(
                    f,
                    "{:<7}{:>5} … {:<6}{:>12}{:>14}{:>14}{:>10} {:<6}{:<4}",
                    format!("{}{}", SIDES[side], axis.name),
                    small,
                    large,
                    number(axis.static_force[side]),
                    number(axis.capacity[side]),
                    number(axis.host_loss_force[side]),
                    number(axis.friction),
                    number(axis.friction_left),
                    axis.unit()
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
        for issue in &self.issues {
            write!(f, "\n{issue}")?;
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
