//! What a session's map looks like: pictures for files, and for windows that draw with the same device.

use itm_core::{ColourImage, Intrinsics, Se3};
use itm_gpu::render::{Of, Scale, Seen, Shading};
use itm_gpu::{Canvas, RaycastImage, Recorder};

use crate::source::BlockSource;
use crate::views::MapViews;
use crate::{Error, Slam};

/// How a map is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// The camera, as large as the picture.
    pub camera: Intrinsics,
    /// Where it is.
    pub world_from_camera: Se3,
    /// How far it sees, in metres.
    pub max_depth_m: f32,
    /// What is shown.
    pub shading: Shading,
    /// The one submap that is shown; `None` for all. Of a map without submaps, and one of surfels, all is shown.
    pub submap: Option<u16>,
}

impl Slam {
    /// A picture of the map as a camera sees it from a pose, up to `max_depth_m`. Pixels that show nothing have alpha 0.
    ///
    /// # Errors
    /// Where the camera is none, the view reaches over more blocks than the device can index, or the device fails.
    pub fn render(
        &mut self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
        shading: Shading,
    ) -> Result<ColourImage, Error> {
        check_camera(camera)?;
        let scale = self.scale(max_depth_m);
        if let Some(surfels) = &self.mapper.surfels {
            let (image, pixels) = surfels.cast(&self.poses_of_submaps(), camera, world_from_camera, max_depth_m)?;
            return Ok(self.render.run(&whole(&image, world_from_camera, Of::Surfels(&pixels)), shading, &scale)?);
        }
        let device = self.device.clone();
        if self.submaps().len() > 1 {
            return self.with_combined(|combined| {
                let mut views = MapViews::new(&device, combined.layout(), 0, 1)?;
                views.look(combined, camera, world_from_camera, max_depth_m)?;
                views.picture(shading, &scale)
            });
        }
        if let Some(mut live) = self.mapper.live()? {
            let mut views = MapViews::new(&device, live.layout(), 0, 1)?;
            views.look(&mut live, camera, world_from_camera, max_depth_m)?;
            return views.picture(shading, &scale);
        }
        let image = RaycastImage::new(&device, *camera)?;
        self.mapper.cast(&image, 0, world_from_camera, max_depth_m)?;
        let seen = whole(&image, world_from_camera, Of::Voxels(&self.mapper.map));
        Ok(self.render.run(&seen, shading, &scale)?)
    }

    /// Paints the map onto a canvas of the camera's size, without a wait: for windows. Blocks that lie in the host's store
    /// are not shown, and of several submaps the surface that is nearest, each submap's for itself; [`Slam::paint_whole`] and
    /// [`Slam::render`] show them all, as one.
    ///
    /// # Errors
    /// Where the canvas has another size than the camera, the view reaches over more blocks than the device can index, or the
    /// device fails.
    pub fn paint(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error> {
        check_canvas(&look.camera, canvas)?;
        let Look { camera, world_from_camera, max_depth_m, shading, submap } = look;
        let scale = self.scale(*max_depth_m);
        let mut recorder = Recorder::new(&self.device);
        canvas.clear(&mut recorder);
        if let Some(surfels) = &self.mapper.surfels {
            let (image, pixels) = surfels.cast(&self.poses_of_submaps(), camera, world_from_camera, *max_depth_m)?;
            let seen = whole(&image, world_from_camera, Of::Surfels(&pixels));
            self.render.paint(&mut recorder, &seen, *shading, &scale, canvas);
        } else {
            let image = match self.painted.take().filter(|image| image.camera() == camera) {
                Some(image) => image,
                None => RaycastImage::new(&self.device, *camera)?,
            };
            let shown = self.submap_poses().into_iter().filter(|(number, _)| submap.is_none_or(|one| one == *number));
            for (number, world_from_map) in shown.collect::<Vec<_>>() {
                let map_from_camera = world_from_map.inverse() * *world_from_camera;
                self.mapper.cast(&image, number, &map_from_camera, *max_depth_m)?;
                let (map_from_camera, world_from_map) = (&map_from_camera, &world_from_map);
                let seen = Seen { image: &image, map_from_camera, world_from_map, of: Of::Voxels(&self.mapper.map) };
                self.render.paint(&mut recorder, &seen, *shading, &scale, canvas);
                // The next submap is cast into the same image, around another grid.
                let painted = std::mem::replace(&mut recorder, Recorder::new(&self.device));
                let _untimed = painted.submit();
            }
            self.painted = Some(image);
        }
        canvas.show(&mut recorder);
        let _untimed = recorder.submit();
        Ok(())
    }

    /// The same with everything that the map has, wherever it lies, and submaps as one surface. Waits, and may take seconds
    /// where much of it is out of the device's memory, or in several submaps.
    ///
    /// # Errors
    /// As [`Slam::paint`].
    pub fn paint_whole(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error> {
        check_canvas(&look.camera, canvas)?;
        if self.paints_whole(look.submap) {
            return self.paint(look, canvas);
        }
        let (device, scale) = (self.device.clone(), self.scale(look.max_depth_m));
        // Of one submap alone, that one in its own frame.
        let alone = look.submap.filter(|_| self.submaps().len() > 1);
        let world_from_map = alone.and_then(|number| self.submaps().get(usize::from(number)));
        let world_from_map = world_from_map.map(|submap| submap.world_from_submap).unwrap_or_default();
        let paint = |source: &mut dyn BlockSource| {
            let mut views = MapViews::new(&device, source.layout(), alone.unwrap_or(0), 1)?;
            views.look(source, &look.camera, &(world_from_map.inverse() * look.world_from_camera), look.max_depth_m)?;
            views.paint_placed(&world_from_map, look.shading, &scale, canvas);
            Ok(())
        };
        if self.submaps().len() > 1 && alone.is_none() {
            return self.with_combined(|combined| paint(combined));
        }
        match self.mapper.live()? {
            Some(mut live) => paint(&mut live),
            None => self.paint(look, canvas),
        }
    }

    /// Whether [`Slam::paint`] shows all that there is of a submap, or of all of them.
    pub fn paints_whole(&self, submap: Option<u16>) -> bool {
        let one = submap.is_some() || self.submaps().len() < 2;
        self.mapper.surfels.is_some() || one && self.stored_blocks() == 0
    }

    /// Paints what the next frame is tracked against, the map from the last frame's pose, onto a canvas of the depth
    /// camera's size: no ray is cast for it. `false`, and an empty canvas, where there is none yet.
    ///
    /// # Errors
    /// Where the canvas has another size than the depth camera, or the device fails.
    pub fn paint_model(&mut self, shading: Shading, canvas: &Canvas) -> Result<bool, Error> {
        check_canvas(&self.calibration.depth, canvas)?;
        let mut recorder = Recorder::new(&self.device);
        canvas.clear(&mut recorder);
        if let Some(pose) = &self.primary.submap_from_model {
            let image = &self.primary.model.image;
            if shading == Shading::Colour && self.mapper.surfels.is_none() {
                // Another view may have been looked at since, or another submap.
                self.mapper.lay_around(&mut recorder, image.camera(), self.primary.submap, pose)?;
            }
            let world_from_submap = self.to_world(&Se3::IDENTITY);
            let of = match &self.mapper.surfels {
                Some(surfels) => Of::Surfels(surfels.drawn()),
                None => Of::Voxels(&self.mapper.map),
            };
            let seen = Seen { image, map_from_camera: pose, world_from_map: &world_from_submap, of };
            let scale = self.scale(self.settings.view.max_depth_m);
            self.render.paint(&mut recorder, &seen, shading, &scale, canvas);
        }
        canvas.show(&mut recorder);
        let _untimed = recorder.submit();
        Ok(self.primary.submap_from_model.is_some())
    }

    /// The ends of the scales of colours.
    fn scale(&self, max_depth_m: f32) -> Scale {
        Scale { depth_m: [0.0, max_depth_m], confidence: crate::views::full_confidence(&self.settings) }
    }
}

/// A canvas shows what a camera as large as it sees, and the camera has to be one.
fn check_canvas(camera: &Intrinsics, canvas: &Canvas) -> Result<(), Error> {
    check_camera(camera)?;
    let (width, height) = canvas.size();
    if (width, height) == (camera.width, camera.height) {
        return Ok(());
    }
    let expected = (camera.width, camera.height);
    Err(itm_gpu::Error::ImageSize { image: "canvas", expected, found: (width, height) }.into())
}

pub(crate) fn check_camera(camera: &Intrinsics) -> Result<(), Error> {
    Ok(camera.validate("picture")?)
}

/// An image of a whole map, in the world's frame.
fn whole<'a>(image: &'a RaycastImage, world_from_camera: &'a Se3, of: Of<'a>) -> Seen<'a> {
    Seen { image, map_from_camera: world_from_camera, world_from_map: &Se3::IDENTITY, of }
}
