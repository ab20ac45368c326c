//! The Python package `itm_slam`: frames in as numpy arrays, poses, meshes and pictures out.
//!
//! Here are conversions between Python's values and the workspace's own, and nothing else: what is done with a frame is
//! `itm-slam`'s, what is done with a command line `itm-cli`'s. The package's types are in `python/itm_slam/_native.pyi`.

mod adapters;
mod arrays;
mod calibration;
mod errors;
mod evaluation;
mod frame;
mod interrupt;
mod recording;
mod result;
mod session;
mod settings;
mod surface;
mod synth;
mod trajectory;

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the program `itm` with a command line, the program's own name first, and returns its exit status.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| itm_cli::main(arguments))
}

/// The compiled part of itm_slam, which exports all of it.
#[pymodule(name = "_native")]
mod native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::adapters::{Adapter, adapters};
    #[pymodule_export]
    use crate::calibration::{Calibration, Intrinsics};
    #[pymodule_export]
    use crate::evaluation::{ErrorStatistics, Evaluation, evaluate};
    #[pymodule_export]
    use crate::frame::Frame;
    #[pymodule_export]
    use crate::main;
    #[pymodule_export]
    use crate::recording::{Frames, Recording, open};
    #[pymodule_export]
    use crate::result::{FrameReport, FrameResult, Happening};
    #[pymodule_export]
    use crate::session::Session;
    #[pymodule_export]
    use crate::settings::resolve_settings;
    #[pymodule_export]
    use crate::surface::{Mesh, PointCloud};
    #[pymodule_export]
    use crate::synth::{Sequence, synth};
    #[pymodule_export]
    use crate::trajectory::Trajectory;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        crate::errors::add_to(module)
    }
}
