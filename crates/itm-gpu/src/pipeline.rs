//! Compiled passes.

use itm_shaders::{Bindings, Pass, SlotKind, Variant};

use crate::Device;

/// A compiled variant of a pass that computes.
#[derive(Debug)]
pub(crate) struct Pipeline {
    pub(crate) bound: Bound,
    pub(crate) pipeline: wgpu::ComputePipeline,
}

impl Pipeline {
    /// Compiles the variant with exactly these features.
    pub(crate) fn new(
        device: &Device,
        pass: &'static Pass,
        features: &[&str],
        constants: &[(&'static str, f64)],
    ) -> Self {
        let (bound, module, layout) = Bound::new(device, pass, features, wgpu::ShaderStages::COMPUTE);
        let pipeline = device.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(pass.name),
            layout: Some(&layout),
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            cache: None,
        });
        Self { bound, pipeline }
    }

    /// Compiles a pass's only variant.
    pub(crate) fn plain(device: &Device, pass: &'static Pass) -> Self {
        Self::new(device, pass, &[], &[])
    }

    /// Compiles a variant of a pass whose workgroups each go over a part of a list ([`crate::surfels::OVER_LIST`]).
    pub(crate) fn over_list(device: &Device, pass: &'static Pass, features: &[&str]) -> Self {
        let lanes = if device.capabilities().software { 8 } else { 64 };
        Self::new(device, pass, features, &[("LANES", f64::from(lanes))])
    }
}

/// A compiled pass that rasterises triangles, of which both sides are shown.
#[derive(Debug)]
pub(crate) struct RasterPipeline {
    pub(crate) bound: Bound,
    pub(crate) pipeline: wgpu::RenderPipeline,
}

impl RasterPipeline {
    /// Format of the depth buffer, in which larger is nearer.
    pub(crate) const DEPTH_BUFFER: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

    /// Compiles a pass's only variant, for targets of formats.
    pub(crate) fn new(device: &Device, pass: &'static Pass, targets: &[wgpu::TextureFormat]) -> Self {
        let stages = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let (bound, module, layout) = Bound::new(device, pass, &[], stages);
        let targets: Vec<_> = targets.iter().map(|format| Some((*format).into())).collect();
        let pipeline = device.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(pass.name),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: Self::DEPTH_BUFFER,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        });
        Self { bound, pipeline }
    }
}

/// A variant of a pass, and what is bound to it.
#[derive(Debug)]
pub(crate) struct Bound {
    pub(crate) pass: &'static Pass,
    variant: &'static Variant,
    layouts: Vec<wgpu::BindGroupLayout>,
}

impl Bound {
    fn new(
        device: &Device,
        pass: &'static Pass,
        features: &[&str],
        visibility: wgpu::ShaderStages,
    ) -> (Self, wgpu::ShaderModule, wgpu::PipelineLayout) {
        let variant = pass
            .variants
            .iter()
            .find(|v| v.features == features)
            .expect("stages ask for variants that the shaders' build lists");
        let module = device.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(pass.name),
            source: wgpu::ShaderSource::Wgsl(variant.source.into()),
        });
        let groups = variant.bindings.iter().map(|s| s.group + 1).max().unwrap_or(0);
        let layouts: Vec<_> = (0..groups)
            .map(|group| {
                let entries: Vec<_> = variant
                    .bindings
                    .iter()
                    .filter(|s| s.group == group)
                    .map(|slot| wgpu::BindGroupLayoutEntry {
                        binding: slot.binding,
                        visibility,
                        ty: wgpu::BindingType::Buffer {
                            ty: match slot.kind {
                                SlotKind::Uniform => wgpu::BufferBindingType::Uniform,
                                SlotKind::ReadOnly => wgpu::BufferBindingType::Storage { read_only: true },
                                SlotKind::ReadWrite => wgpu::BufferBindingType::Storage { read_only: false },
                            },
                            has_dynamic_offset: false,
                            min_binding_size: None,
                        },
                        count: None,
                    })
                    .collect();
                device.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some(pass.name),
                    entries: &entries,
                })
            })
            .collect();
        let layout = device.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(pass.name),
            bind_group_layouts: &layouts.iter().map(Some).collect::<Vec<_>>(),
            immediate_size: 0,
        });
        (Self { pass, variant, layouts }, module, layout)
    }

    /// The bind groups with a pass's bindings; `uniform` is where the bytes of its uniform will lie.
    pub(crate) fn groups<B: Bindings>(
        &self,
        device: &Device,
        bindings: &B,
        uniform: Option<&wgpu::BufferBinding<'_>>,
    ) -> Vec<wgpu::BindGroup> {
        let of_group = |(layout, group)| {
            let slots = self.variant.bindings.iter().filter(|slot| slot.group == group);
            let entries: Vec<_> = slots
                .map(|slot| {
                    let resource = if slot.kind == SlotKind::Uniform {
                        wgpu::BindingResource::Buffer(uniform.expect("a pass with a uniform has its bytes").clone())
                    } else {
                        bindings
                            .storage(group, slot.binding)
                            .unwrap_or_else(|| panic!("{} needs '{}'", self.pass.name, slot.name))
                            .as_entire_binding()
                    };
                    wgpu::BindGroupEntry { binding: slot.binding, resource }
                })
                .collect();
            device.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(self.pass.name),
                layout,
                entries: &entries,
            })
        };
        self.layouts.iter().zip(0..).map(of_group).collect()
    }
}
