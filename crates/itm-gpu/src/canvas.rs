//! Pictures that stay on the device.

use std::sync::OnceLock;

use itm_shaders::Bindings;

use crate::pipeline::RasterPipeline;
use crate::{Device, Error, Recorder};

const COLOURS: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
const DEPTHS: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// A picture on the device, for an application to show that draws with the same one: nothing passes through the host.
///
/// What is painted (see [`crate::render`] and [`crate::mesh_view`]) is in the texture once the recording that copies it there
/// has been submitted; the device does what the application submits afterwards later.
#[derive(Debug)]
pub struct Canvas {
    size: (u32, u32),
    /// Red, green, blue, alpha from the lowest byte up, in rows of [`Canvas::pitch`] words.
    pub(crate) painted: wgpu::Buffer,
    /// Depth of each pixel in metres, in rows of as many words; 0 where nothing is shown.
    pub(crate) depths: wgpu::Buffer,
    texture: wgpu::Texture,
    /// What a stage that rasterises draws into beside the texture: depths, and a depth buffer. Made once it is needed.
    targets: OnceLock<[wgpu::Texture; 2]>,
}

impl Canvas {
    /// What [`Canvas::rasterise`] draws into.
    pub(crate) const TARGETS: [wgpu::TextureFormat; 2] = [COLOURS, DEPTHS];

    /// An empty picture.
    ///
    /// # Errors
    /// Where a side is zero or longer than the device's textures may be.
    pub fn new(device: &Device, (width, height): (u32, u32)) -> Result<Self, Error> {
        let longest = device.device.limits().max_texture_dimension_2d;
        if width == 0 || height == 0 || width.max(height) > longest {
            return Err(Error::CanvasSize { width, height, longest });
        }
        let texture = target(
            device,
            (width, height),
            COLOURS,
            wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::TEXTURE_BINDING,
        );
        let bytes = u64::from(pitch(width)) * u64::from(height) * 4;
        Ok(Self {
            size: (width, height),
            painted: device.storage("canvas", bytes),
            depths: device.storage("depths of canvas", bytes),
            texture,
            targets: OnceLock::new(),
        })
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The picture: RGBA of 8 bits, sRGB values in a texture that is not declared as such; alpha 0, and black, where nothing
    /// is shown.
    pub fn texture(&self) -> &wgpu::Texture {
        &self.texture
    }

    pub(crate) fn pitch(&self) -> u32 {
        pitch(self.size.0)
    }

    /// Records that triangles are painted, in place of what was painted before, by a pass that writes a pixel's colour first
    /// and its depth second. The colours are drawn into the texture, which so shows them already.
    pub(crate) fn rasterise<B: Bindings>(
        &self,
        device: &Device,
        recorder: &mut Recorder,
        pipeline: &RasterPipeline,
        lists: &[(B, &wgpu::Buffer)],
    ) {
        let [depths, depth_buffer] = self.targets.get_or_init(|| {
            [
                target(device, self.size, DEPTHS, wgpu::TextureUsages::COPY_SRC),
                target(device, self.size, RasterPipeline::DEPTH_BUFFER, wgpu::TextureUsages::empty()),
            ]
        });
        recorder.rasterise(pipeline, lists, &[&self.texture, depths], depth_buffer);
        recorder.copy_from_texture(&self.texture, &self.painted, self.pitch());
        recorder.copy_from_texture(depths, &self.depths, self.pitch());
    }

    /// Records that nothing is shown.
    pub fn clear(&self, recorder: &mut Recorder) {
        recorder.clear(&self.painted, self.painted.size());
        recorder.clear(&self.depths, self.depths.size());
    }

    /// Records that what was painted is in the texture.
    pub fn show(&self, recorder: &mut Recorder) {
        recorder.copy_to_texture(&self.painted, self.pitch(), &self.texture);
    }

    /// Depth along the optical axis of what a pixel shows, in metres; `None` where it shows nothing, and outside. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn depth(&self, device: &Device, (x, y): (u32, u32)) -> Result<Option<f32>, Error> {
        let (width, height) = self.size;
        if x >= width || y >= height {
            return Ok(None);
        }
        let at = u64::from(y) * u64::from(self.pitch()) + u64::from(x);
        let depth = device.read::<f32>(&self.depths, at * 4, 4)?;
        Ok(depth.first().copied().filter(|depth| *depth > 0.0))
    }

    /// Reads what was painted back, row by row. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(&self, device: &Device) -> Result<itm_core::ColourImage, Error> {
        let (width, height) = self.size;
        let padded: Vec<[u8; 4]> = device.read(&self.painted, 0, u64::from(self.pitch()) * u64::from(height) * 4)?;
        let rows = padded.chunks_exact(self.pitch() as usize);
        let values = rows.flat_map(|row| row[..width as usize].iter().copied()).collect();
        Ok(itm_core::ColourImage::new(width, height, values).expect("as many values as pixels"))
    }
}

/// A texture that can be drawn into.
fn target(
    device: &Device,
    (width, height): (u32, u32),
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    device.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("canvas"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: usage | wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    })
}

/// Words of a row, as copies to textures want them: a multiple of 256 bytes.
fn pitch(width: u32) -> u32 {
    width.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT / 4)
}
