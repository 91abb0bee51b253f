//! Checks that settings, servos and model are consistent, before they are resolved to [`Params`].

use nalgebra::DMatrix;

use super::Params;
use crate::error::{Error, Result};
use crate::model::Model;
use crate::params::{Follow, ServoArrays, Settings};

/// Returns an error if the task has more axes than the arm has joints, and no length that weights translations against
/// rotations.
pub(super) fn check_axes(settings: &Settings, k: usize, n: usize) -> Result<()> {
    if k <= n || settings.task.length.is_some() {
        return Ok(());
    }
    Err(Error::config(
        "task.axes",
        format!(
            "{k} axes on an arm of {n} joints cannot all be met: take away at least {} (e.g. axes=\"xyz\"), \
             or give task.length [m], the distance that counts as much as one radian",
            k - n
        ),
    ))
}

/// Returns an error under law `paper` if `null_space.max_torque` is above 0 but there is no null space.
pub(super) fn check_null_torque(settings: &Settings, k: usize, n: usize) -> Result<()> {
    if settings.law.by_force() || k < n || settings.null_space.max_torque.is_none_or(|torque| torque <= 0.0) {
        return Ok(());
    }
    Err(Error::config(
        "null_space.max_torque",
        format!("{k} task axes leave no null space on {n} joints: leave it out, or take away an axis"),
    ))
}

/// Returns an error if the gain K_x increases the deviation in some direction, or exceeds the bound for the delay.
pub(super) fn check_gain(settings: &Settings, params: &Params) -> Result<()> {
    let symmetric = DMatrix::from_fn(params.k, params.k, |r, c| 0.5 * (params.kx[r][c] + params.kx[c][r]));
    let shift = 1e-9 * (1.0 + symmetric.amax());
    if (symmetric + DMatrix::identity(params.k, params.k) * shift).cholesky().is_none() {
        return Err(Error::config(
            "tracking.gain",
            "drives some direction away from its target: K + Kᵀ has a negative eigenvalue",
        ));
    }
    let (gain, bound) =
        (params.gain(settings.paper_options.horizon), params.gain_bound(settings.delay, 1.0 / settings.rate));
    if settings.law.bounds_gain() && gain > bound * (1.0 + 1e-12) {
        return Err(Error::out_of_range(
            "tracking.gain · horizon",
            gain,
            format!(
                "(0, {bound:.3}]: with a delay of {} s at {} Hz a stiffer loop oscillates; lower tracking.gain, or shorten delay and period",
                settings.delay, settings.rate
            ),
        ));
    }
    Ok(())
}

/// Returns an error if gravity is compensated at a joint that moves an unknown mass, unless `torque_limits.floor` is
/// set.
pub(super) fn check_gravity(model: &Model, settings: &Settings) -> Result<()> {
    let unknown = model.unknown_mass_joints();
    if settings.gravity_use() == crate::params::GravityUse::Off
        || unknown.is_empty()
        || settings.torque_limits.floor.is_some()
    {
        return Ok(());
    }
    let names: Vec<&str> = unknown.iter().map(|&i| model.joint_names()[i].as_str()).collect();
    Err(Error::config(
        "gravity",
        format!(
            "the mass that joints {} move is unknown, so gravity cannot be compensated there: add <inertial> to the \
             URDF, or give torque_limits=TorqueLimits(floor=[...]) [N·m] for the limits, or gravity=False",
            names.join(", ")
        ),
    ))
}

/// Returns an error if the settings require the servos' stiffness `k_p` but no servos are configured.
pub(super) fn check_kp(settings: &Settings, servos: &ServoArrays, model: &Model) -> Result<()> {
    if servos.has_kp {
        return Ok(());
    }
    let wants = match settings.law {
        law if law.by_force() => Some(format!("law=\"{law}\"")),
        _ if settings.paper_options.budget_on_goal => Some("budget_on_goal=True".into()),
        _ if settings.effective_follow() == Follow::Free => Some("follow=\"free\"".into()),
        _ if settings.gravity_use().in_goal() => Some("gravity in the goals".into()),
        _ => None,
    };
    wants.map_or(Ok(()), |what| {
        Err(Error::config(
            "servos",
            format!(
                "{what} needs the stiffness k_p of joints {}: give servos=Servos(kp=[...] [N·m/rad], max_torque=[...] [N·m]), \
                 from the servo's table or identified on the arm",
                model.joint_names().join(", ")
            ),
        ))
    })
}
