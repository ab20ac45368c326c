//! The WGSL shaders of itm and the typed bindings generated from them at build time.
//!
//! A pass is one `.wgsl` file with one entry point `main` that computes, or two, `vertex` and `fragment`, that rasterise;
//! files in `shared/` are imported by several (WESL imports, `import package::shared::camera::Camera;`). Some passes come in
//! variants (`@if(colour)`). For each pass there is a module of the same name with a `Bindings` struct that has a field for
//! each binding and, where the pass has a uniform, its `Params`. A binding that is renamed, added or left out does not
//! compile on the host; a struct cannot differ from WGSL's, because it is made from it.

#![allow(clippy::doc_markdown, reason = "doc comments of passes are their WGSL files' first lines")]

/// One pass: of compute shaders, or of shaders that rasterise.
#[derive(Debug)]
pub struct Pass {
    /// Name of the WGSL file without its ending: `integrate`, `mesh/count`. The pass has this name everywhere.
    pub name: &'static str,
    /// Its variants; the first one has no features.
    pub variants: &'static [Variant],
}

/// One variant of a pass.
#[derive(Debug)]
pub struct Variant {
    /// The WESL features that are on.
    pub features: &'static [&'static str],
    /// Validated WGSL with all imports resolved.
    pub source: &'static str,
    /// The bindings, by group and number.
    pub bindings: &'static [Slot],
}

/// One binding of a variant.
#[derive(Debug)]
pub struct Slot {
    /// Name in WGSL.
    pub name: &'static str,
    /// Bind group.
    pub group: u32,
    /// Number within the group.
    pub binding: u32,
    /// What is bound.
    pub kind: SlotKind,
}

/// What is bound to a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotKind {
    /// A uniform buffer.
    Uniform,
    /// A storage buffer that is only read.
    ReadOnly,
    /// A storage buffer that is read and written.
    ReadWrite,
}

/// What a pass is run with; implemented by the generated `Bindings` structs.
pub trait Bindings {
    /// The pass.
    const PASS: &'static Pass;

    /// The bytes of the uniform; empty where the pass has none.
    fn uniform(&self) -> &[u8];

    /// The storage buffer for a slot, or `None` where the slot is not a storage buffer or was left out.
    fn storage(&self, group: u32, binding: u32) -> Option<&wgpu::Buffer>;
}

include!(concat!(env!("OUT_DIR"), "/passes.rs"));
