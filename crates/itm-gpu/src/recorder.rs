//! Recording commands by name.

use itm_shaders::{Bindings, Pass, SlotKind, Variant};

use crate::{Device, Error};

/// Bytes of one uniform buffer; a recorder takes more of them as it needs.
pub(crate) const UNIFORM_BYTES: u64 = 64 << 10;
/// Compute passes that one recorder times; later ones are not timed.
const TIMED_PASSES: u32 = 64;

/// A compiled variant of a pass.
#[derive(Debug)]
pub(crate) struct Pipeline {
    pass: &'static Pass,
    variant: &'static Variant,
    pipeline: wgpu::ComputePipeline,
    layouts: Vec<wgpu::BindGroupLayout>,
}

impl Pipeline {
    /// Compiles the variant with exactly these features.
    pub(crate) fn new(
        device: &Device,
        pass: &'static Pass,
        features: &[&str],
        constants: &[(&'static str, f64)],
    ) -> Self {
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
                        visibility: wgpu::ShaderStages::COMPUTE,
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
        let pipeline = device.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(pass.name),
            layout: Some(&layout),
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            cache: None,
        });
        Self { pass, variant, pipeline, layouts }
    }

    /// Compiles a pass's only variant.
    pub(crate) fn plain(device: &Device, pass: &'static Pass) -> Self {
        Self::new(device, pass, &[], &[])
    }
}

/// How many workgroups to dispatch.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Groups<'a> {
    /// So many.
    Count([u32; 3]),
    /// As many as three words of a buffer say, from this word on.
    Indirect(&'a wgpu::Buffer, u32),
}

impl Groups<'_> {
    /// Enough workgroups of `size` for `count` invocations, up to a dispatch's limit; such passes stride over the rest.
    pub(crate) fn linear(count: u64, size: u32) -> Self {
        let groups = count.div_ceil(size.into()).clamp(1, 65_535);
        Self::Count([u32::try_from(groups).expect("clamped"), 1, 1])
    }

    /// Enough workgroups of `size` for an image.
    pub(crate) fn image((width, height): (u32, u32), size: (u32, u32)) -> Self {
        Self::Count([width.div_ceil(size.0).max(1), height.div_ceil(size.1).max(1), 1])
    }
}

/// Records commands; nothing runs before [`Recorder::submit`].
pub struct Recorder {
    device: Device,
    encoder: wgpu::CommandEncoder,
    pass: Option<wgpu::ComputePass<'static>>,
    stage: &'static str,
    uniforms: Vec<wgpu::Buffer>,
    /// What goes into the uniform buffers, one after the other.
    uniform_bytes: Vec<u8>,
    timer: Option<Timer>,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder").field("stage", &self.stage).finish_non_exhaustive()
    }
}

struct Timer {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    /// The stage of each timed pass.
    stages: Vec<&'static str>,
}

impl Recorder {
    /// A recorder whose stages are not timed.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            encoder: device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default()),
            pass: None,
            stage: "",
            uniforms: Vec::new(),
            uniform_bytes: Vec::new(),
            timer: None,
        }
    }

    /// A recorder whose stages are timed, where the device can.
    pub fn timed(device: &Device) -> Self {
        let mut recorder = Self::new(device);
        if device.capabilities().timestamps {
            let bytes = u64::from(TIMED_PASSES) * 2 * 8;
            recorder.timer = Some(Timer {
                queries: device.device.create_query_set(&wgpu::QuerySetDescriptor {
                    label: Some("stage times"),
                    ty: wgpu::QueryType::Timestamp,
                    count: TIMED_PASSES * 2,
                }),
                resolved: device.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("stage times"),
                    size: bytes,
                    usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                }),
                staging: device.staging("stage times", bytes),
                stages: Vec::new(),
            });
        }
        recorder
    }

    /// Names the stage that the following commands belong to.
    pub fn stage(&mut self, name: &'static str) {
        if self.stage != name {
            self.pass = None;
            self.stage = name;
        }
    }

    pub(crate) fn dispatch<B: Bindings>(&mut self, pipeline: &Pipeline, bindings: &B, groups: Groups<'_>) {
        debug_assert_eq!(B::PASS.name, pipeline.pass.name, "bindings and pipeline of different passes");
        let uniform = bindings.uniform();
        let uniform_at = (!uniform.is_empty()).then(|| self.push_uniform(uniform));
        let bind_groups: Vec<_> = pipeline
            .layouts
            .iter()
            .zip(0..)
            .map(|(layout, group)| {
                let entries: Vec<_> = pipeline
                    .variant
                    .bindings
                    .iter()
                    .filter(|slot| slot.group == group)
                    .map(|slot| {
                        let resource = if slot.kind == SlotKind::Uniform {
                            let (buffer, offset) = uniform_at.expect("a pass with a uniform has its bytes");
                            wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                                buffer: &self.uniforms[buffer],
                                offset,
                                size: wgpu::BufferSize::new(uniform.len() as u64),
                            })
                        } else {
                            bindings
                                .storage(group, slot.binding)
                                .unwrap_or_else(|| panic!("{} needs '{}'", pipeline.pass.name, slot.name))
                                .as_entire_binding()
                        };
                        wgpu::BindGroupEntry { binding: slot.binding, resource }
                    })
                    .collect();
                self.device.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some(pipeline.pass.name),
                    layout,
                    entries: &entries,
                })
            })
            .collect();
        let pass = self.pass();
        pass.set_pipeline(&pipeline.pipeline);
        for (group, index) in bind_groups.iter().zip(0..) {
            pass.set_bind_group(index, group, &[]);
        }
        match groups {
            Groups::Count([x, y, z]) => pass.dispatch_workgroups(x, y, z),
            Groups::Indirect(buffer, word) => pass.dispatch_workgroups_indirect(buffer, u64::from(word) * 4),
        }
    }

    fn pass(&mut self) -> &mut wgpu::ComputePass<'static> {
        if self.pass.is_none() {
            let mut writes = None;
            if let Some(timer) = &mut self.timer {
                let next = timer.stages.len() as u32;
                if next < TIMED_PASSES {
                    timer.stages.push(self.stage);
                    writes = Some(wgpu::ComputePassTimestampWrites {
                        query_set: &timer.queries,
                        beginning_of_pass_write_index: Some(2 * next),
                        end_of_pass_write_index: Some(2 * next + 1),
                    });
                }
            }
            let descriptor = wgpu::ComputePassDescriptor { label: Some(self.stage), timestamp_writes: writes };
            self.pass = Some(self.encoder.begin_compute_pass(&descriptor).forget_lifetime());
        }
        self.pass.as_mut().expect("just begun")
    }

    /// Puts a uniform's bytes into the current buffer, or the next one where it is full. Returns buffer and offset.
    fn push_uniform(&mut self, bytes: &[u8]) -> (usize, u64) {
        let align = self.device.device.limits().min_uniform_buffer_offset_alignment as usize;
        let mut at = self.uniform_bytes.len().next_multiple_of(align);
        let capacity = UNIFORM_BYTES as usize;
        if at % capacity + bytes.len() > capacity {
            at = at.next_multiple_of(capacity);
        }
        while self.uniforms.len() * capacity < at + bytes.len() {
            self.uniforms.push(self.device.take_uniforms());
        }
        self.uniform_bytes.resize(at, 0);
        self.uniform_bytes.extend_from_slice(bytes);
        (at / capacity, (at % capacity) as u64)
    }

    /// Zeroes the first `bytes` of a buffer.
    pub(crate) fn clear(&mut self, buffer: &wgpu::Buffer, bytes: u64) {
        self.pass = None;
        self.encoder.clear_buffer(buffer, 0, Some(bytes.next_multiple_of(4).min(buffer.size())));
    }

    /// Zeroes one word of a buffer.
    pub(crate) fn clear_word(&mut self, buffer: &wgpu::Buffer, word: u32) {
        self.pass = None;
        self.encoder.clear_buffer(buffer, u64::from(word) * 4, Some(4));
    }

    /// Copies the first `bytes` of a buffer to the start of another.
    pub(crate) fn copy(&mut self, from: &wgpu::Buffer, to: &wgpu::Buffer, bytes: u64) {
        self.pass = None;
        self.encoder.copy_buffer_to_buffer(from, 0, to, 0, bytes);
    }

    /// Hands everything recorded to the device and returns at once. The result reads the stages' times later.
    pub fn submit(mut self) -> StageTimes {
        self.pass = None;
        if let Some(timer) = &self.timer {
            let count = 2 * timer.stages.len() as u32;
            if count > 0 {
                self.encoder.resolve_query_set(&timer.queries, 0..count, &timer.resolved, 0);
                self.encoder.copy_buffer_to_buffer(&timer.resolved, 0, &timer.staging, 0, u64::from(count) * 8);
            }
        }
        for (buffer, bytes) in self.uniforms.iter().zip(self.uniform_bytes.chunks(UNIFORM_BYTES as usize)) {
            // Queue writes happen after what was submitted before and before what is submitted next, so the buffer may
            // still be in use by an earlier recording.
            self.device.queue.write_buffer(buffer, 0, bytes);
        }
        self.device.queue.submit([self.encoder.finish()]);
        self.device.return_uniforms(self.uniforms);
        StageTimes { timer: self.timer }
    }
}

/// The times of one recording's stages, which are read once it has been done.
#[must_use]
pub struct StageTimes {
    timer: Option<Timer>,
}

impl std::fmt::Debug for StageTimes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StageTimes").finish_non_exhaustive()
    }
}

impl StageTimes {
    /// Milliseconds of each stage, in the order of their first commands; empty where the device has no clock. Waits for
    /// the recording.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<Vec<(&'static str, f64)>, Error> {
        let Some(timer) = self.timer.filter(|t| !t.stages.is_empty()) else { return Ok(Vec::new()) };
        let ticks: Vec<u64> = device.read_staging(&timer.staging, 16 * timer.stages.len() as u64)?;
        let ms_per_tick = f64::from(device.queue.get_timestamp_period()) * 1e-6;
        let mut times: Vec<(&'static str, f64)> = Vec::new();
        for (stage, pair) in timer.stages.iter().zip(ticks.chunks_exact(2)) {
            let ms = pair[1].saturating_sub(pair[0]) as f64 * ms_per_tick;
            match times.iter_mut().find(|(name, _)| name == stage) {
                Some((_, sum)) => *sum += ms,
                None => times.push((stage, ms)),
            }
        }
        Ok(times)
    }
}
