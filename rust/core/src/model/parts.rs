//! Links and joints as the file gives them; what a simulator builds its robot from.

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

/// A rigid body, or a mere frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Unique, not empty.
    pub name: String,
    /// Joint above it; `None` for the root.
    pub parent_joint: Option<usize>,
    /// `None`: no `<inertial>`, a massless link.
    pub inertial: Option<Inertial>,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// About an axis, between limits.
    Revolute,
    /// About an axis, without end.
    Continuous,
    /// Along an axis.
    Prismatic,
    /// Not at all.
    Fixed,
    /// Floating, planar, spherical: held at its zero pose, and refused between base and tip.
    Other,
}

impl JointKind {
    /// Whether the joint has one coordinate.
    pub const fn is_actuated(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

/// A joint that follows another: its coordinate is `multiplier · q + offset`.
///
/// Resolved: `joint` follows nobody, also where the file chains one mimic to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mimic {
    /// The joint that leads (index into [`Model::joints`](super::Model::joints)).
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
    /// How it moves.
    pub kind: JointKind,
    /// The file's word for `kind`.
    pub type_name: String,
    /// Link above (index into [`Model::links`](super::Model::links)).
    pub parent: usize,
    /// Link below.
    pub child: usize,
    /// `parent_from_child` at zero.
    pub origin: Pose,
    /// Unit axis in the joint's frame; z for joints that have none.
    pub axis: [f64; 3],
    /// Lower position limit [rad or m]; `None`: absent.
    pub lower: Option<f64>,
    /// Upper position limit [rad or m]; `None`: absent.
    pub upper: Option<f64>,
    /// Speed limit [rad/s or m/s]; `None`: absent, 0 or infinite.
    pub velocity: Option<f64>,
    /// Torque or force limit [N·m or N]; `None`: absent, 0 or infinite.
    pub effort: Option<f64>,
    /// Damping [N·m·s/rad or N·s/m].
    pub damping: Option<f64>,
    /// Dry friction [N·m or N].
    pub friction: Option<f64>,
    /// The joint that it follows.
    pub mimic: Option<Mimic>,
    /// Coordinate of the chain that moves it, as the coordinate's own joint or by mimic.
    pub q_index: Option<usize>,
    /// Where it is held [rad or m], for actuated joints that no coordinate moves.
    pub locked_at: Option<f64>,
    /// Line and column of the joint's element.
    pub(crate) at: Position,
}

impl Joint {
    /// Where the joint is held when nobody says: 0, or the limit nearest to it.
    pub(super) fn resting_value(&self) -> f64 {
        0.0_f64.max(self.lower.unwrap_or(f64::NEG_INFINITY)).min(self.upper.unwrap_or(f64::INFINITY))
    }
}
