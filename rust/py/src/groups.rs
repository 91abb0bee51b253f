//! Python classes for groups of settings: `Tracking`, `NullSpace`, `Compensation`, `TorqueLimits`, `PaperOptions`.
//!
//! A group records which fields were given to its constructor. As an argument of `Settings`, a preset or `replace` it
//! changes these fields only.

use std::marker::PhantomData;

use pliant_core::params as core;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::error::{OrRaise, config, shown};
use crate::fields::{Fields, Special, fields};
use crate::kinds::{AxisGains, Dampings, Flag, Gains, Joints, Kind, Number, Optional};
use crate::words::Word;

/// Bitmask of the fields that were given to the constructor of a group; bit i stands for entry i of [`Fields::NAMES`].
pub(crate) type FieldMask = u32;

/// Mask in which all fields are given.
const ALL: FieldMask = FieldMask::MAX;

/// A value class for a group of settings, which records the fields that were given to its constructor.
pub(crate) trait Grouped: Fields
where
    Self::Core: Default,
{
    /// Returns the values and the mask of the given fields if `value` is of this class, else `None`.
    fn of(value: &Bound<'_, PyAny>) -> Option<(Self::Core, FieldMask)>;

    /// Creates a Python object of this class; `given` is the mask of the given fields.
    fn object(core: Self::Core, given: FieldMask, py: Python<'_>) -> PyResult<Bound<'_, PyAny>>;
}

/// Returns true if the mask `given` contains the field `name`.
fn has<G: Fields>(given: FieldMask, name: &str) -> bool {
    G::NAMES.iter().position(|known| *known == name).is_some_and(|bit| given >> bit & 1 == 1)
}

/// Returns the mask of the fields that are keys of `names`; 0 for `None`.
fn bits<G: Fields>(names: Option<&Bound<'_, PyDict>>) -> PyResult<FieldMask> {
    let Some(names) = names else { return Ok(0) };
    let mut given = 0;
    for (bit, name) in G::NAMES.iter().enumerate() {
        given |= FieldMask::from(names.contains(name)?) << bit;
    }
    Ok(given)
}

/// Conversion of a field of `Settings` that holds a group of class `G`.
pub(crate) struct Group<G>(PhantomData<G>);

impl<G: Grouped> Kind for Group<G>
where
    G::Core: Default,
{
    type Core = G::Core;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<G::Core> {
        let mut core = G::Core::default();
        Self::update(&mut core, name, value)?;
        Ok(core)
    }

    fn update(core: &mut G::Core, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let Some((from, given)) = G::of(value) else {
            let example = G::NAMES[0];
            let message = format!("must be a {0} such as {0}({example}=...), got {1}", G::CLASS, shown(value));
            return Err(config(name, message));
        };
        G::copy(core, &from, |field| has::<G>(given, field));
        Ok(())
    }

    fn plain<'py>(core: &G::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let changed = G::changed(core, &G::Core::default(), py)?;
        G::object(core.clone(), bits::<G>(Some(&changed))?, py)
    }

    fn show<'py>(core: &G::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        G::object(core.clone(), ALL, py)
    }
}

macro_rules! group {
    ($class:ident($name:literal, $owner:literal, $module:literal), $text:literal { $($field:ident: $kind:ty,)* }) => {
        #[doc = stub!($class)]
        #[pyclass(name = $name, module = $module, frozen, eq, from_py_object)]
        #[derive(Debug, Clone)]
        pub(crate) struct $class(pub(crate) core::$class, FieldMask);

        // Compares the values only, not which fields were given.
        impl PartialEq for $class {
            fn eq(&self, other: &Self) -> bool {
                self.0 == other.0
            }
        }

        impl $class {
            fn check(core: &core::$class) -> PyResult<Self> {
                core.validate().or_raise()?;
                Ok(Self(core.clone(), ALL))
            }

            fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                Self::chosen(&self.0, |name| has::<Self>(self.1, name), py)
            }
        }

        impl Special for $class {
            fn after(self, before: Option<&Self>, changes: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
                Ok(Self(self.0, before.map_or(0, |before| before.1) | bits::<Self>(changes)?))
            }
        }

        impl Grouped for $class {
            fn of(value: &Bound<'_, PyAny>) -> Option<(Self::Core, FieldMask)> {
                value.cast::<Self>().ok().map(|group| (group.get().0.clone(), group.get().1))
            }

            fn object(core: Self::Core, given: FieldMask, py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
                Ok(Bound::new(py, Self(core, given))?.into_any())
            }
        }

        fields! {
            $class($name, $owner) of core::$class {
                $($field: $kind,)*
            }
        }

        #[pymethods]
        impl $class {
            #[new]
            #[pyo3(signature = (**fields), text_signature = $text)]
            fn new(fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
                Self::with(core::$class::default(), fields)?.after(None, fields)
            }
        }
    };
}

group! {
    Tracking("Tracking", "tracking.", "pliant"),
    "(*, gain=4.0, damping=None, velocity_filter=0.02, goal_slew=1.0, joint_speed=None, integrate=0.0)" {
        gain: AxisGains,
        damping: Dampings,
        velocity_filter: Number,
        goal_slew: Number,
        joint_speed: Optional<Joints>,
        integrate: Number,
    }
}

group! {
    NullSpace("NullSpace", "null_space.", "pliant"),
    "(*, posture=None, gain=None, max_torque=None, stiffness=None, max_speed=None, limit_avoidance=0.0, projector='exact')" {
        posture: Optional<Joints>,
        gain: Optional<Number>,
        max_torque: Optional<Number>,
        stiffness: Optional<Number>,
        max_speed: Number,
        limit_avoidance: Number,
        projector: Word<core::Projector>,
    }
}

group! {
    Compensation("Compensation", "compensation.", "pliant"),
    "(*, friction=0.9, damping=0.8, delay=0.9)" {
        friction: Number,
        damping: Number,
        delay: Number,
    }
}

group! {
    TorqueLimits("TorqueLimits", "torque_limits.", "pliant"),
    "(*, margin=0.1, floor=None, stiffening_time=0.2, max_host_loss_force=None)" {
        margin: Number,
        floor: Optional<Joints>,
        stiffening_time: Number,
        max_host_loss_force: Optional<Number>,
    }
}

group! {
    PaperOptions("PaperOptions", "paper_options.", "pliant.functional"),
    "(*, follow=None, limits='demand', horizon=0.25, kq=1.0, joint_weights=None, posture_weights=None, manipulability=0.0, gravity_use='both', gravity_scale=1.1, friction_speed=0.05, direction_band=None, raw_deviation=False, budget_on_goal=False, lead_limit=None)" {
        follow: Optional<Word<core::Follow>>,
        limits: Word<core::LimitRule>,
        horizon: Number,
        kq: Gains,
        joint_weights: Optional<Joints>,
        posture_weights: Optional<Joints>,
        manipulability: Number,
        gravity_use: Word<core::GravityUse>,
        gravity_scale: Number,
        friction_speed: Number,
        direction_band: Optional<Number>,
        raw_deviation: Flag,
        budget_on_goal: Flag,
        lead_limit: Optional<Number>,
    }
}

/// Returns a hint such as `; use tracking=Tracking(gain=...).` with the groups that have the field `name`; `None` if no
/// group has it.
pub(crate) fn owner(name: &str) -> Option<String> {
    let groups: [(&str, &str, &[&str]); 4] = [
        ("tracking", Tracking::CLASS, Tracking::NAMES),
        ("null_space", NullSpace::CLASS, NullSpace::NAMES),
        ("compensation", Compensation::CLASS, Compensation::NAMES),
        ("torque_limits", TorqueLimits::CLASS, TorqueLimits::NAMES),
    ];
    let owners = groups.iter().filter(|(_, _, names)| names.contains(&name));
    let calls: Vec<String> = owners.map(|(field, class, _)| format!("{field}={class}({name}=...)")).collect();
    (!calls.is_empty()).then(|| format!("; use {}.", calls.join(" or ")))
}
