//! Immutable, validated robot model, read from URDF text.
//!
//! [`Model`] is one kinematic chain, base → tip, with all bodies that it carries. Mesh files are not opened. A value
//! that the URDF does not give is `None`, not zero. Error messages name the file, the line and a remedy.

use std::io::Read as _;
use std::path::Path;

mod bodies;
mod chain;
mod names;
mod options;
mod parts;
mod roles;
mod tree;
mod urdf;

pub use chain::Chain;
pub use options::{ModelOptions, Payload};
pub use parts::{Inertial, Joint, JointKind, Link, Mimic};

use crate::error::{Error, Position, Result};
use names::some;
pub(crate) use options::finite_vector;
use options::{need_limits, override_limits};
use tree::Tree;
use urdf::text::{self, Source};

/// Robot model: one kinematic chain with all bodies that it carries; immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    tree: Tree,
    chain: Chain,
    base: usize,
    tip: usize,
    joint_names: Vec<String>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    velocity_limit: Vec<Option<f64>>,
    effort_limit: Vec<Option<f64>>,
    prismatic: Vec<bool>,
    unknown_mass: Vec<usize>,
    payload: Option<Payload>,
    gravity: [f64; 3],
    reach: f64,
}

impl Model {
    /// Reads a URDF file.
    ///
    /// # Errors
    /// [`Error::Urdf`] with file, line and column for errors in the text; [`Error::FrameNotFound`],
    /// [`Error::OutOfRange`] and [`Error::Config`] for options that do not fit the file.
    ///
    /// ```
    /// # use pliant_core::{Model, ModelOptions};
    /// # fn main() -> pliant_core::Result<()> {
    /// # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/arm7.urdf");
    /// let options = ModelOptions { base: Some("base".into()), tip: Some("tool".into()), ..ModelOptions::default() };
    /// let model = Model::from_urdf_file(path, &options)?;
    /// assert_eq!(model.joint_names()[0], "shoulder_pitch");
    /// # Ok(())
    /// # }
    /// ```
    pub fn from_urdf_file(path: impl AsRef<Path>, options: &ModelOptions) -> Result<Self> {
        Self::from_urdf_file_with_text(path, options).map(|(model, _)| model)
    }

    /// Reads a URDF file as [`Model::from_urdf_file`]; returns the model and the text of the file.
    ///
    /// # Errors
    /// As [`Model::from_urdf_file`].
    pub fn from_urdf_file_with_text(path: impl AsRef<Path>, options: &ModelOptions) -> Result<(Self, String)> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let unreadable = |message: String| Error::Urdf { source_name: name.clone(), at: Position(None), message };
        // Reading from a named pipe without a writer would block forever.
        if std::fs::metadata(path).is_ok_and(|data| !data.is_file()) {
            return Err(unreadable(
                "cannot be read: it is not a file; for text from a pipe there is from_urdf_str".into(),
            ));
        }
        let mut bytes = Vec::new();
        // One byte more than allowed: a longer text is then rejected by the check of its size.
        std::fs::File::open(path)
            .and_then(|file| file.take(text::MAX_BYTES as u64 + 1).read_to_end(&mut bytes))
            .map_err(|error| unreadable(format!("cannot be read: {error}")))?;
        let text = String::from_utf8(bytes)
            .map_err(|error| unreadable(format!("is not UTF-8 text (byte {})", error.utf8_error().valid_up_to())))?;
        let model = Self::read(&name, &text, options)?;
        Ok((model, text))
    }

    /// Reads URDF text.
    ///
    /// # Errors
    /// As [`Model::from_urdf_file`]; the source is named `<string>`.
    ///
    /// ```
    /// # use pliant_core::{Model, ModelOptions};
    /// # fn main() -> pliant_core::Result<()> {
    /// let urdf = r#"<robot name="lever">
    ///     <link name="base"/>
    ///     <joint name="hinge" type="revolute">
    ///         <parent link="base"/><child link="tool"/><axis xyz="0 0 1"/>
    ///         <limit lower="-1" upper="1" effort="5" velocity="6"/>
    ///     </joint>
    ///     <link name="tool"/>
    /// </robot>"#;
    /// let model = Model::from_urdf_str(urdf, &ModelOptions::default())?;
    /// assert_eq!((model.n(), model.lower()), (1, &[-1.0][..])); // [rad]
    /// # Ok(())
    /// # }
    /// ```
    pub fn from_urdf_str(text: &str, options: &ModelOptions) -> Result<Self> {
        Self::read("<string>", text, options)
    }

    fn read(name: &str, text: &str, options: &ModelOptions) -> Result<Self> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        finite_vector("gravity", "m/s²", &options.gravity)?;
        if let Some(payload) = &options.payload {
            payload.validate()?;
        }
        let source = Source::new(name, text);
        let mut tree = Tree::read(&source)?;
        override_limits(&mut tree, &options.limits)?;
        let base = options.base.as_deref().map_or(Ok(tree.root), |name| tree.frame(name))?;
        let tip = match &options.tip {
            Some(name) => tree.frame(name)?,
            None => only_tip(&tree, base)?,
        };
        let assembly = chain::assemble(&mut tree, base, tip, options)?;
        let independent = &assembly.independent;
        for &j in independent {
            need_limits(&tree, j)?;
        }
        let joints = || independent.iter().map(|&j| &tree.joints[j]);
        let has_payload = options.payload.is_some_and(|payload| payload.mass > 0.0);
        let last = independent.len() - 1;
        Ok(Self {
            base,
            tip,
            joint_names: joints().map(|joint| joint.name.clone()).collect(),
            lower: joints().map(|joint| joint.lower.unwrap_or(f64::NEG_INFINITY)).collect(),
            upper: joints().map(|joint| joint.upper.unwrap_or(f64::INFINITY)).collect(),
            velocity_limit: joints().map(|joint| joint.velocity).collect(),
            effort_limit: joints().map(|joint| joint.effort).collect(),
            prismatic: joints().map(|joint| joint.kind == JointKind::Prismatic).collect(),
            unknown_mass: assembly.massless.into_iter().filter(|&i| !(has_payload && i == last)).collect(),
            payload: options.payload,
            gravity: options.gravity,
            reach: assembly.reach,
            chain: assembly.chain,
            tree,
        })
    }

    /// Returns the name of the robot.
    pub fn name(&self) -> &str {
        &self.tree.name
    }

    /// Returns the number n of independent joints.
    pub const fn n(&self) -> usize {
        self.chain.n()
    }

    /// Returns the names of the independent joints, base → tip, without mimic joints.
    pub fn joint_names(&self) -> &[String] {
        &self.joint_names
    }

    /// Returns the lower position limits [rad or m]; −∞ for continuous joints.
    pub fn lower(&self) -> &[f64] {
        &self.lower
    }

    /// Returns the upper position limits [rad or m]; +∞ for continuous joints.
    pub fn upper(&self) -> &[f64] {
        &self.upper
    }

    /// Returns the speed limits of the URDF [rad/s or m/s]; `None` if absent.
    pub fn velocity_limit(&self) -> &[Option<f64>] {
        &self.velocity_limit
    }

    /// Returns the torque or force limits of the URDF [N·m or N]; `None` if absent.
    pub fn effort_limit(&self) -> &[Option<f64>] {
        &self.effort_limit
    }

    /// Returns, for each independent joint, whether it is prismatic.
    pub fn prismatic(&self) -> &[bool] {
        &self.prismatic
    }

    /// Returns the names of all links of the robot; each can be named as base or tip.
    pub fn frames(&self) -> Vec<&str> {
        self.tree.links.iter().map(|link| link.name.as_str()).collect()
    }

    /// Returns the name of the link in whose frame poses are expressed.
    pub fn base(&self) -> &str {
        &self.tree.links[self.base].name
    }

    /// Returns the name of the link that is the tool frame.
    pub fn tip(&self) -> &str {
        &self.tree.links[self.tip].name
    }

    /// Returns the payload at the tool; `None` without one.
    pub const fn payload(&self) -> Option<&Payload> {
        self.payload.as_ref()
    }

    /// Returns gravity in the base frame [m/s²].
    pub const fn gravity_vector(&self) -> [f64; 3] {
        self.gravity
    }

    /// Returns an upper bound [m] on the distance of the tool from the first joint: the sum of the distances between
    /// joint origins up to the tool, plus the largest displacements of prismatic joints.
    pub const fn reach(&self) -> f64 {
        self.reach
    }

    /// Returns the indices of the independent joints that move a rigid group without mass; their gravity torque is
    /// unknown.
    ///
    /// A link without `<inertial>` counts as massless. A joint is listed only if all links of its group are massless.
    pub fn unknown_mass_joints(&self) -> &[usize] {
        &self.unknown_mass
    }

    /// Returns all links of the robot, for example for a simulator.
    pub fn links(&self) -> &[Link] {
        &self.tree.links
    }

    /// Returns all joints of the robot, for example for a simulator.
    pub fn joints(&self) -> &[Joint] {
        &self.tree.joints
    }

    /// Returns the kinematic chain, in the arrays that the control step uses.
    pub const fn chain(&self) -> &Chain {
        &self.chain
    }
}

/// Returns the default tip, the only link below the base that has no child; an error if there are several.
fn only_tip(tree: &Tree, base: usize) -> Result<usize> {
    let (mut is_leaf, mut stack) = (vec![false; tree.links.len()], vec![base]);
    while let Some(link) = stack.pop() {
        is_leaf[link] = tree.children[link].is_empty();
        stack.extend(tree.children[link].iter().map(|&j| tree.joints[j].child));
    }
    let leaves: Vec<usize> = (0..is_leaf.len()).filter(|&link| is_leaf[link]).collect();
    if let [tip] = leaves[..] {
        return Ok(tip);
    }
    let ends = some(leaves.iter().map(|&l| tree.links[l].name.as_str()));
    let frames = some(tree.links.iter().map(|link| link.name.as_str()));
    Err(Error::config(
        "tip",
        format!(
            "this robot branches and ends in {} links: {ends}; say which frame is the tool, of: {frames}",
            leaves.len()
        ),
    ))
}
