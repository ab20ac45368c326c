//! Recording commands by name.

use itm_shaders::Bindings;

pub(crate) use crate::pipeline::Pipeline;
use crate::pipeline::{Bound, RasterPipeline};
use crate::{Device, Error};

/// Bytes of one uniform buffer; a recorder takes more of them as it needs.
pub(crate) const UNIFORM_BYTES: u64 = 64 << 10;
/// Passes that one recorder times; later ones are not timed.
const TIMED_PASSES: u32 = 64;

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
    /// Where a paced device is timed: stages and milliseconds by the host's clock, which waits for each of them. Software drivers
    /// read a pass's first time no sooner than they must, which may be once its work is done.
    waited: Option<Vec<(&'static str, f64)>>,
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

impl Timer {
    /// The queries at the beginning and the end of the next pass, where it is timed.
    fn next(&mut self, stage: &'static str) -> Option<(&wgpu::QuerySet, u32, u32)> {
        let next = self.stages.len() as u32;
        (next < TIMED_PASSES).then(|| {
            self.stages.push(stage);
            (&self.queries, 2 * next, 2 * next + 1)
        })
    }
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
            waited: None,
        }
    }

    /// A recorder whose stages are timed, where the device can.
    pub fn timed(device: &Device) -> Self {
        let mut recorder = Self::new(device);
        if device.is_paced() {
            recorder.waited = Some(Vec::new());
        } else if device.capabilities().timestamps {
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
            if self.device.is_paced() && !self.stage.is_empty() {
                self.flush();
            }
            self.stage = name;
        }
    }

    pub(crate) fn dispatch<B: Bindings>(&mut self, pipeline: &Pipeline, bindings: &B, groups: Groups<'_>) {
        let bind_groups = self.bind(&pipeline.bound, bindings);
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

    /// Rasterises lists of triangles, each the whole of an index buffer, onto targets that are cleared first: colours and
    /// values to zero, and the depth buffer, in which larger is nearer, to the farthest.
    pub(crate) fn rasterise<B: Bindings>(
        &mut self,
        pipeline: &RasterPipeline,
        lists: &[(B, &wgpu::Buffer)],
        targets: &[&wgpu::Texture],
        depth_buffer: &wgpu::Texture,
    ) {
        let bind_groups: Vec<_> = lists.iter().map(|(bindings, _)| self.bind(&pipeline.bound, bindings)).collect();
        self.pass = None;
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let (targets, depth_buffer) = (targets.iter().map(|t| view(t)).collect::<Vec<_>>(), view(depth_buffer));
        let clear =
            wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), store: wgpu::StoreOp::Store };
        let attachments: Vec<_> = targets
            .iter()
            .map(|view| {
                Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops: clear })
            })
            .collect();
        let nearness = wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard };
        let timed = self.timer.as_mut().and_then(|timer| timer.next(self.stage));
        let mut pass = self.encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(self.stage),
            color_attachments: &attachments,
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &depth_buffer,
                depth_ops: Some(nearness),
                stencil_ops: None,
            }),
            timestamp_writes: timed.map(|(query_set, begin, end)| wgpu::RenderPassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(begin),
                end_of_pass_write_index: Some(end),
            }),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_pipeline(&pipeline.pipeline);
        for (bind_groups, (_, indices)) in bind_groups.iter().zip(lists) {
            for (group, index) in bind_groups.iter().zip(0..) {
                pass.set_bind_group(index, group, &[]);
            }
            pass.set_index_buffer(indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..(indices.size() / 4) as u32, 0, 0..1);
        }
    }

    /// A pass's bind groups, with the uniform's bytes noted.
    fn bind<B: Bindings>(&mut self, bound: &Bound, bindings: &B) -> Vec<wgpu::BindGroup> {
        debug_assert_eq!(B::PASS.name, bound.pass.name, "bindings and pipeline of different passes");
        let uniform = bindings.uniform();
        let uniform_at = (!uniform.is_empty()).then(|| self.push_uniform(uniform));
        let uniform = uniform_at.map(|(buffer, offset)| wgpu::BufferBinding {
            buffer: &self.uniforms[buffer],
            offset,
            size: wgpu::BufferSize::new(uniform.len() as u64),
        });
        bound.groups(&self.device, bindings, uniform.as_ref())
    }

    fn pass(&mut self) -> &mut wgpu::ComputePass<'static> {
        if self.pass.is_none() {
            let timed = self.timer.as_mut().and_then(|timer| timer.next(self.stage));
            let descriptor = wgpu::ComputePassDescriptor {
                label: Some(self.stage),
                timestamp_writes: timed.map(|(query_set, begin, end)| wgpu::ComputePassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: Some(begin),
                    end_of_pass_write_index: Some(end),
                }),
            };
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

    /// Copies a picture, whose rows are `pitch` words apart, to a texture.
    pub(crate) fn copy_to_texture(&mut self, from: &wgpu::Buffer, pitch: u32, to: &wgpu::Texture) {
        self.pass = None;
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(pitch * 4), rows_per_image: None };
        let source = wgpu::TexelCopyBufferInfo { buffer: from, layout };
        self.encoder.copy_buffer_to_texture(source, to.as_image_copy(), to.size());
    }

    /// Copies a texture of a word a pixel to a buffer whose rows are `pitch` words apart.
    pub(crate) fn copy_from_texture(&mut self, from: &wgpu::Texture, to: &wgpu::Buffer, pitch: u32) {
        self.pass = None;
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(pitch * 4), rows_per_image: None };
        let target = wgpu::TexelCopyBufferInfo { buffer: to, layout };
        self.encoder.copy_texture_to_buffer(from.as_image_copy(), target, from.size());
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
        self.flush();
        StageTimes { timer: self.timer, waited: self.waited }
    }

    /// Hands over what was recorded so far, and, where the device is paced, waits until it has been done.
    fn flush(&mut self) {
        for (buffer, bytes) in self.uniforms.iter().zip(self.uniform_bytes.chunks(UNIFORM_BYTES as usize)) {
            // Queue writes happen after what was submitted before and before what is submitted next, so the buffer may
            // still be in use by an earlier recording.
            self.device.queue.write_buffer(buffer, 0, bytes);
        }
        let empty = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let recorded = std::mem::replace(&mut self.encoder, empty);
        let started = std::time::Instant::now();
        self.device.submit(recorded.finish());
        self.device.return_uniforms(std::mem::take(&mut self.uniforms));
        self.uniform_bytes.clear();
        if self.device.is_paced() {
            // An error stays noted, and is found where the caller next waits.
            let _noted = self.device.wait();
            if let Some(waited) = &mut self.waited {
                waited.push((self.stage, started.elapsed().as_secs_f64() * 1e3));
            }
        }
    }
}

/// The times of one recording's stages, which are read once it has been done.
#[must_use]
pub struct StageTimes {
    timer: Option<Timer>,
    waited: Option<Vec<(&'static str, f64)>>,
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
        if let Some(waited) = self.waited {
            return Ok(by_stage(waited.into_iter().filter(|(stage, _)| !stage.is_empty())));
        }
        let Some(timer) = self.timer.filter(|t| !t.stages.is_empty()) else { return Ok(Vec::new()) };
        let ticks: Vec<u64> = device.read_staging(&timer.staging, 16 * timer.stages.len() as u64)?;
        let ms_per_tick = f64::from(device.queue.get_timestamp_period()) * 1e-6;
        let ms = |pair: &[u64]| pair[1].saturating_sub(pair[0]) as f64 * ms_per_tick;
        Ok(by_stage(timer.stages.into_iter().zip(ticks.chunks_exact(2).map(ms))))
    }
}

/// The sums of stages' times, in the order of their first ones.
fn by_stage(times: impl Iterator<Item = (&'static str, f64)>) -> Vec<(&'static str, f64)> {
    let mut sums: Vec<(&'static str, f64)> = Vec::new();
    for (stage, ms) in times {
        match sums.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += ms,
            None => sums.push((stage, ms)),
        }
    }
    sums
}
