//! What can compute here.

use pyo3::prelude::*;

/// A graphics adapter.
#[pyclass(module = "itm_slam", frozen, get_all)]
pub(crate) struct Adapter {
    /// Its name, a part of which chooses it.
    name: String,
    /// What it is, as an integrated GPU or the processor.
    kind: String,
    /// API: Vulkan, Metal, Dx12.
    backend: String,
    /// Driver and its version.
    driver: String,
    /// Blocks of 8x8x8 voxels that the largest map can hold.
    max_blocks: u64,
    /// Why it cannot be used; None where it can.
    unfit: Option<String>,
}

#[pymethods]
impl Adapter {
    fn __repr__(&self) -> String {
        format!("<Adapter '{}', {}, {}>", self.name, self.kind, self.backend)
    }
}

/// The graphics adapters of this machine, the best first.
#[pyfunction]
pub(crate) fn adapters(py: Python<'_>) -> Vec<Adapter> {
    let found = py.detach(itm_slam::Device::adapters);
    let adapter = |a: itm_slam::AdapterReport| Adapter {
        name: a.name,
        kind: a.kind.to_string(),
        backend: a.backend,
        driver: a.driver,
        max_blocks: a.max_blocks,
        unfit: a.unfit,
    };
    found.into_iter().map(adapter).collect()
}
