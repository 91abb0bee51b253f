//! Links and joints as in the file; simulators build their robot from them.

use crate::error::Position;
use crate::pose::Pose;

/// Mass, centre of mass and inertia of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass [kg], finite, ≥ 0.
    pub mass: f64,
    /// Centre of mass in the link's frame [m].
    pub com: [f64; 3],
    /// Axes in which the inertia is given: `link_from_inertia`, row-major.
    pub rotation: [[f64; 3]; 3],
    /// Inertia about the centre of mass, in those axes [kg·m²].
    pub inertia: [[f64; 3]; 3],
}

/// A rigid body, or a frame without mass.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Unique, not empty.
    pub name: String,
    /// Joint above it; `None` for the root.
    pub parent_joint: Option<usize>,
    /// `None` without `<inertial>`: a massless link.
    pub inertial: Option<Inertial>,
}

/// Type of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Rotation about an axis, between limits.
    Revolute,
    /// Rotation about an axis, without limits.
    Continuous,
    /// Translation along an axis.
    Prismatic,
    /// No motion.
    Fixed,
    /// Floating, planar, spherical: held at its zero pose, and refused between base and tip.
    Other,
}

impl JointKind {
    /// Returns true if the joint has one coordinate.
    pub const fn is_actuated(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

/// Mimic of a joint: its coordinate is `multiplier · q + offset`.
///
/// Resolved: `joint` itself is never a mimic joint, also if the file chains several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mimic {
    /// The driving joint (index into [`Model::joints`](super::Model::joints)).
    pub joint: usize,
    /// Ratio, finite, not 0.
    pub multiplier: f64,
    /// Offset [rad or m].
    pub offset: f64,
}

/// A joint of the tree.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Unique, not empty.
    pub name: String,
    /// Type of the joint.
    pub kind: JointKind,
    /// Name of the type in the file.
    pub type_name: String,
    /// Parent link (index into [`Model::links`](super::Model::links)).
    pub parent: usize,
    /// Child link.
    pub child: usize,
    /// `parent_from_child` at zero.
    pub origin: Pose,
    /// Unit axis in the joint's frame; z for joints without an axis.
    pub axis: [f64; 3],
    /// Lower position limit [rad or m]; `None` if absent.
    pub lower: Option<f64>,
    /// Upper position limit [rad or m]; `None` if absent.
    pub upper: Option<f64>,
    /// Speed limit [rad/s or m/s]; `None` if absent, 0 or infinite.
    pub velocity: Option<f64>,
    /// Torque or force limit [N·m or N]; `None` if absent, 0 or infinite.
    pub effort: Option<f64>,
    /// Damping [N·m·s/rad or N·s/m].
    pub damping: Option<f64>,
    /// Dry friction [N·m or N].
    pub friction: Option<f64>,
    /// Mimic parameters, for a mimic joint.
    pub mimic: Option<Mimic>,
    /// Coordinate of the chain that drives it, directly or by mimic.
    pub q_index: Option<usize>,
    /// Value at which it is locked [rad or m], for actuated joints without a coordinate.
    pub locked_at: Option<f64>,
    /// Line and column of the joint's element.
    pub(crate) at: Position,
}

impl Joint {
    /// Default value of a locked joint: 0, or the limit nearest to 0.
    pub(super) fn resting_value(&self) -> f64 {
        0.0_f64.max(self.lower.unwrap_or(f64::NEG_INFINITY)).min(self.upper.unwrap_or(f64::INFINITY))
    }
}
