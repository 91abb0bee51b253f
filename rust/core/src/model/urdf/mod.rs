//! URDF text → links and joints: our guard checks the text, urdf-rs parses it, the reader converts its types.

pub(super) mod guard;
pub(super) mod reader;
pub(super) mod text;
