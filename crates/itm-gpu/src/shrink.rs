//! Stage `shrink`: the small, smooth images that a relocaliser compares (Glocker et al. 2015, *Real-Time RGB-D Camera
//! Relocalization via Randomized Ferns for Keyframe Encoding*, section 3).

use itm_core::{ColourImage, Image, Intrinsics};
use itm_shaders::shrink;

use crate::recorder::{Groups, Pipeline};
use crate::{Device, Error, Recorder, View};

/// The stage's pipelines and memory, for small images of one size.
#[derive(Debug)]
pub struct Shrink {
    device: Device,
    size: [u32; 2],
    sigma: f32,
    with_colour: bool,
    depth: Pipeline,
    colour: Pipeline,
    smooth: Pipeline,
    cells: wgpu::Buffer,
    small: [wgpu::Buffer; 2],
}

impl Shrink {
    /// Prepares the stage for small images of a width and height, smoothed by a Gaussian whose standard deviation is given in
    /// their pixels; 0 for none. Colour is shrunk where asked for.
    pub fn new(device: &Device, (width, height): (u32, u32), sigma: f32, with_colour: bool) -> Self {
        let bytes = u64::from(width) * u64::from(height) * 16;
        Self {
            device: device.clone(),
            size: [width, height],
            sigma,
            with_colour,
            depth: Pipeline::new(device, &shrink::average::PASS, &[], &[]),
            colour: Pipeline::new(device, &shrink::average::PASS, &["colour"], &[]),
            smooth: Pipeline::plain(device, &shrink::smooth::PASS),
            cells: device.storage("cells", bytes),
            small: [device.storage("small depth", bytes), device.storage("small colour", bytes)],
        }
    }

    /// Records the shrinking of a view's depth, and of its colour where that was asked for and the view has one.
    pub fn record(&self, recorder: &mut Recorder, view: &View) -> SmallReader {
        recorder.stage("shrink");
        let [width, height] = self.size;
        let cells = Groups::Count([width, height, 1]);
        let params = |camera: &Intrinsics| shrink::average::Params {
            size: [camera.width, camera.height],
            small_size: self.size,
        };
        let bindings = shrink::average::Bindings {
            params: params(view.level_camera(0)),
            depth: Some(view.depth()),
            colours: None,
            small: &self.cells,
        };
        recorder.dispatch(&self.depth, &bindings, cells);
        self.smooth(recorder, &self.small[0]);
        if let Some((camera, colour)) = view.level_colour(0).filter(|_| self.with_colour) {
            let bindings = shrink::average::Bindings {
                params: params(camera),
                depth: None,
                colours: Some(colour),
                small: &self.cells,
            };
            recorder.dispatch(&self.colour, &bindings, cells);
            self.smooth(recorder, &self.small[1]);
        }
        let bytes = self.small[0].size();
        let read = |recorder: &mut Recorder, small| {
            let staging = self.device.staging("small image", bytes);
            recorder.copy(small, &staging, bytes);
            staging
        };
        let depth = read(recorder, &self.small[0]);
        let colour = (view.has_colour() && self.with_colour).then(|| read(recorder, &self.small[1]));
        SmallReader { size: self.size, depth, colour }
    }

    fn smooth(&self, recorder: &mut Recorder, small: &wgpu::Buffer) {
        let bindings = shrink::smooth::Bindings {
            params: shrink::smooth::Params {
                size: self.size,
                sigma: self.sigma,
                reach: (3.0 * self.sigma).ceil().min(1e3) as i32,
            },
            small: &self.cells,
            smooth_image: small,
        };
        recorder.dispatch(&self.smooth, &bindings, Groups::image((self.size[0], self.size[1]), (8, 8)));
    }
}

/// Small images that are read once they have been made.
#[must_use]
#[derive(Debug)]
pub struct SmallReader {
    size: [u32; 2],
    depth: wgpu::Buffer,
    colour: Option<wgpu::Buffer>,
}

impl SmallReader {
    /// Depth in metres, 0 where there is none, and colours, whose fourth byte is 0 where there is none; `None` for a view
    /// without colour. Waits for the recording.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<(Image<f32>, Option<ColourImage>), Error> {
        let [width, height] = self.size;
        let read = |staging: &wgpu::Buffer| -> Result<Vec<[f32; 4]>, Error> {
            device.read_staging(staging, u64::from(width) * u64::from(height) * 16)
        };
        let depth = read(&self.depth)?.into_iter().map(|value| value[0]).collect();
        let byte = |v: f32| (255.0 * v).round() as u8;
        let colour = match &self.colour {
            Some(staging) => Some(read(staging)?.into_iter().map(|value| value.map(byte)).collect()),
            None => None,
        };
        let sized = "as many values as pixels";
        Ok((
            Image::new(width, height, depth).expect(sized),
            colour.map(|colour| ColourImage::new(width, height, colour).expect(sized)),
        ))
    }
}
