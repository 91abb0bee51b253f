//! Links and joints of the kinematic tree, as parsed from the robot description.

use crate::error::Position;
use crate::pose::Pose;

/// Inertial parameters of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass [kg], finite, ≥ 0.
    pub mass: f64,
    /// Centre of mass in the link's frame [m].
    pub com: [f64; 3],
    /// Rotation `link_from_inertia` (row-major) of the frame in which `inertia` is given.
    pub rotation: [[f64; 3]; 3],
    /// Inertia about the centre of mass [kg·m²], in the axes of the inertia frame (see `rotation`).
    pub inertia: [[f64; 3]; 3],
}

/// A link of the tree: a rigid body, or a frame without mass.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Name of the link; unique, not empty.
    pub name: String,
    /// Joint between this link and its parent (index into [`Model::joints`](super::Model::joints)); `None` for the
    /// root.
    pub parent_joint: Option<usize>,
    /// Inertial parameters; `None` without `<inertial>`, for a massless link.
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
    /// Floating, planar or spherical. Such a joint is kept at its zero pose; between base and tip it is an error.
    Other,
}

impl JointKind {
    /// Returns true for a joint with one degree of freedom: revolute, continuous or prismatic.
    pub const fn is_actuated(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

/// Parameters of a mimic joint, whose value is `multiplier · q + offset` at the value q of `joint`.
///
/// `joint` itself is never a mimic joint, even if the file chains several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mimic {
    /// The driving joint (index into [`Model::joints`](super::Model::joints)).
    pub joint: usize,
    /// Ratio to the value of `joint`; finite, not 0.
    pub multiplier: f64,
    /// Value of the mimic joint at the value 0 of `joint` [rad or m].
    pub offset: f64,
}

/// A joint of the tree.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name of the joint; unique, not empty.
    pub name: String,
    /// Type of the joint.
    pub kind: JointKind,
    /// Name of the joint's type in the file.
    pub type_name: String,
    /// Parent link (index into [`Model::links`](super::Model::links)).
    pub parent: usize,
    /// Child link (index into [`Model::links`](super::Model::links)).
    pub child: usize,
    /// Pose `parent_from_child` at joint value 0.
    pub origin: Pose,
    /// Unit axis in the joint's frame; the z axis for types without an axis.
    pub axis: [f64; 3],
    /// Lower position limit [rad or m]; `None` if absent.
    pub lower: Option<f64>,
    /// Upper position limit [rad or m]; `None` if absent.
    pub upper: Option<f64>,
    /// Speed limit [rad/s or m/s]; `None` if absent, 0 or infinite.
    pub velocity: Option<f64>,
    /// Torque or force limit [N·m or N]; `None` if absent, 0 or infinite.
    pub effort: Option<f64>,
    /// Viscous damping [N·m·s/rad or N·s/m]; `None` if absent.
    pub damping: Option<f64>,
    /// Dry friction [N·m or N]; `None` if absent.
    pub friction: Option<f64>,
    /// Mimic parameters; `None` if the joint does not mimic another joint.
    pub mimic: Option<Mimic>,
    /// Index in q of the independent joint that drives this joint (itself, or by mimic); `None` for a joint that does
    /// not move with the chain.
    pub q_index: Option<usize>,
    /// Value at which the joint is locked [rad or m]; `None` for a joint that moves with the chain or cannot move.
    pub locked_at: Option<f64>,
    /// Position of the joint's element in the file, for messages.
    pub(crate) at: Position,
}

impl Joint {
    /// Returns the default value of a locked joint: 0, or the limit nearest to 0.
    pub(super) fn resting_value(&self) -> f64 {
        0.0_f64.max(self.lower.unwrap_or(f64::NEG_INFINITY)).min(self.upper.unwrap_or(f64::INFINITY))
    }
}
