//! Pose → joint positions: a convenience, not part of the control step.

/// Options.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct IkOptions {}
/// Reason.
#[derive(Debug, Clone, PartialEq)]
pub enum IkReason {}
/// Solution.
#[derive(Debug, Clone, PartialEq)]
pub struct IkSolution {}
