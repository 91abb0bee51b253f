//! Reading of URDF text: the guard checks it, urdf-rs parses it, the reader converts links and joints.

pub(super) mod guard;
pub(super) mod reader;
pub(super) mod text;
