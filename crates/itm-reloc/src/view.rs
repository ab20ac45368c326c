//! What a relocaliser looks at.

use glam::{DVec2, DVec3};
use itm_core::{ColourImage, Image, Intrinsics, Se3};

use crate::Error;

/// What the camera sees, smoothed and shrunk to some tens of pixels each way, so that two views from nearly the same place are
/// nearly the same.
///
/// It is made elsewhere, to the size and smoothing that `relocaliser.width`, `height` and `smoothing_px` ask for. What has no
/// depth should not have taken part in the smoothing.
#[derive(Clone, Debug, PartialEq)]
pub struct SmallView {
    depth: Image<f32>,
    colour: Option<ColourImage>,
    /// Of a view that was made from another, the pixels of which that one tells something; none where all of them are seen.
    known: Option<Vec<bool>>,
}

impl SmallView {
    /// A view of depth in metres along the optical axis, 0 where there is none (whatever is not positive and finite becomes 0),
    /// and of colour, where there is any: red, green, blue and a byte that is 0 where a pixel has no colour.
    ///
    /// # Errors
    /// [`Error::ViewSize`] where the colour image has another size than the depth image.
    pub fn new(mut depth: Image<f32>, colour: Option<ColourImage>) -> Result<Self, Error> {
        if let Some(colour) = colour.as_ref().filter(|colour| colour.size() != depth.size()) {
            return Err(Error::ViewSize { what: "colour", expected: depth.size(), found: colour.size() });
        }
        for depth in depth.data_mut().iter_mut().filter(|depth| !(depth.is_finite() && **depth > 0.0)) {
            *depth = 0.0;
        }
        Ok(Self { depth, colour, known: None })
    }

    /// What the view would be for a camera elsewhere, as far as it tells. `camera` is that of its depth image at any
    /// size; `view_from_camera` takes points in metres from the other camera's frame to the view's. Colour
    /// moves with depth, as if its image were registered.
    ///
    /// Pixels that show what the view did not are unknown, which is not the same as nothing seen: ferns that look at them are not
    /// compared. So it is something to compare with keyframes, and cannot become one. Where the view shows nothing, there is taken
    /// to be nothing as near as what it shows, for that is why most such pixels are empty.
    #[must_use]
    pub fn seen_from(&self, camera: &Intrinsics, view_from_camera: &Se3) -> Self {
        let (width, height) = self.size();
        let camera = camera.scaled_to(width, height);
        let farthest = f64::from(self.depth().iter().copied().fold(0.0, f32::max));
        let mut seen = Seen::new(self, &camera, view_from_camera.inverse());
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        for (x, y) in pixels.enumerate().filter(|(at, _)| self.is_known(*at)).map(|(_, pixel)| pixel) {
            let z = f64::from(self.depth[(x, y)]);
            let is_empty = z <= 0.0;
            // The image is smooth: each pixel is a little plane.
            let slope = |ahead: Option<&f32>, behind: Option<&f32>| {
                let ends = [ahead, behind].map(|v| v.filter(|v| **v > 0.0).map_or(z, |v| f64::from(*v)));
                if is_empty { 0.0 } else { 0.5 * (ends[0] - ends[1]) }
            };
            let back = |v: u32| v.checked_sub(1);
            let across = slope(self.depth.get(x + 1, y), back(x).and_then(|x| self.depth.get(x, y)));
            let down = slope(self.depth.get(x, y + 1), back(y).and_then(|y| self.depth.get(x, y)));
            // Several points a pixel, so that what comes nearer has no holes.
            for (u, v) in THIRDS.into_iter().flat_map(|v| THIRDS.map(|u| (u, v))) {
                let pixel = DVec2::new(f64::from(x) + u, f64::from(y) + v);
                let z = if is_empty { farthest } else { z + u * across + v * down };
                // A plane at an edge may reach behind the camera, and of an empty view nothing is known.
                if z > 0.0 {
                    seen.put(camera.unproject(pixel, z), (x, y), is_empty);
                }
            }
        }
        let Seen { nearest, depth, colour, .. } = seen;
        let known = nearest.iter().map(|near| *near < f64::INFINITY).collect();
        Self { depth, colour, known: Some(known) }
    }

    /// Whether it tells of all its pixels, as a view that was seen does and not one made by [`SmallView::seen_from`].
    pub(crate) fn is_whole(&self) -> bool {
        self.known.is_none()
    }

    /// Whether a pixel, counted row by row, is one of which the view tells something; see [`SmallView::seen_from`].
    pub(crate) fn is_known(&self, pixel: usize) -> bool {
        self.known.as_ref().is_none_or(|known| known[pixel])
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.depth.size()
    }

    /// Depth in metres, row by row, 0 where there is none.
    pub fn depth(&self) -> &[f32] {
        self.depth.data()
    }

    /// Red, green, blue and a byte that is 0 where there is no colour, row by row, if the view has a colour image.
    pub fn colour(&self) -> Option<&[[u8; 4]]> {
        self.colour.as_ref().map(Image::data)
    }

    /// Share of the pixels that have depth, 0 to 1; 0 of an image without pixels.
    pub fn depth_share(&self) -> f64 {
        share(self.depth(), |depth| *depth > 0.0)
    }

    /// Share of the pixels that have a colour, 0 to 1; 0 without a colour image.
    pub fn colour_share(&self) -> f64 {
        share(self.colour().unwrap_or_default(), |colour| colour[3] != 0)
    }
}

/// Where a pixel's points lie, in pixels from its middle.
const THIRDS: [f64; 3] = [-1.0 / 3.0, 0.0, 1.0 / 3.0];

/// What a camera elsewhere sees of a view.
struct Seen<'a> {
    view: &'a SmallView,
    camera: &'a Intrinsics,
    camera_from_view: Se3,
    /// How near what each pixel shows is, in metres: empty space is behind all else, and infinity what nothing is known of.
    nearest: Vec<f64>,
    depth: Image<f32>,
    colour: Option<ColourImage>,
}

impl<'a> Seen<'a> {
    fn new(view: &'a SmallView, camera: &'a Intrinsics, camera_from_view: Se3) -> Self {
        let (width, height) = view.size();
        let depth = Image::filled(width, height, 0.0);
        let colour = view.colour.as_ref().map(|_| Image::filled(width, height, [0; 4]));
        Self { view, camera, camera_from_view, nearest: vec![f64::INFINITY; depth.data().len()], depth, colour }
    }

    /// Puts a point of the view's pixel `from`, in metres in the view's frame, where it is seen, if nothing nearer is there.
    fn put(&mut self, point: DVec3, from: (u32, u32), is_empty: bool) {
        let point = self.camera_from_view.transform_point(point);
        let Some(to) = self.camera.project(point) else { return };
        let (width, height) = self.depth.size();
        let (x, y) = ((to.x + 0.5).floor(), (to.y + 0.5).floor());
        if !(x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height)) {
            return;
        }
        let at = y as usize * width as usize + x as usize;
        let near = if is_empty { f64::MAX } else { point.z };
        if near < self.nearest[at] {
            self.nearest[at] = near;
            self.depth.data_mut()[at] = if is_empty { 0.0 } else { point.z as f32 };
            if let (Some(colour), Some(own)) = (&mut self.colour, &self.view.colour) {
                colour.data_mut()[at] = own[from];
            }
        }
    }
}

fn share<T>(pixels: &[T], valid: impl Fn(&T) -> bool) -> f64 {
    pixels.iter().filter(|pixel| valid(pixel)).count() as f64 / pixels.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_depth_reads_as_none() {
        let depth = Image::new(5, 1, vec![f32::NAN, f32::INFINITY, -1.0, 0.0, 2.0]).unwrap();
        let view = SmallView::new(depth, None).unwrap();
        assert_eq!(view.depth(), [0.0, 0.0, 0.0, 0.0, 2.0]);
        assert_eq!((view.depth_share(), view.colour_share()), (0.2, 0.0));
    }

    /// What a camera in front of a corner sees: two walls that meet, and a floor.
    fn corner(camera: &Intrinsics, world_from_camera: &Se3) -> SmallView {
        let planes = [DVec3::new(0.8, 0.0, 0.6), DVec3::new(-0.6, 0.0, 0.8), DVec3::new(0.0, 1.0, 0.0)];
        let distances = [2.4, 2.0, 1.1];
        let depth = Image::from_fn(camera.width, camera.height, |x, y| {
            let ray = world_from_camera.transform_vector(camera.unproject(DVec2::new(x.into(), y.into()), 1.0));
            let depth = planes.iter().zip(distances).map(|(plane, distance)| {
                let along = (distance - plane.dot(world_from_camera.translation)) / plane.dot(ray);
                if along > 0.0 { along } else { f64::INFINITY }
            });
            depth.fold(f64::INFINITY, f64::min) as f32
        });
        SmallView::new(depth, None).unwrap()
    }

    #[test]
    fn what_is_seen_from_elsewhere_is_known_where_it_was_in_view() {
        let camera = Intrinsics::new(40, 30, 33.0, 33.0, 19.5, 14.5);
        let here = corner(&camera, &Se3::IDENTITY);
        for (twist, least_known) in [
            ([0.0, 0.0, 0.5, 0.0, 0.0, 0.0], 1150),
            ([0.0, 0.0, -0.5, 0.0, 0.0, 0.0], 600),
            ([0.3, 0.0, 0.0, 0.0, -0.1, 0.0], 900),
            ([0.0, 0.0, 0.0, 0.0, 0.4, 0.0], 600),
        ] {
            let there = Se3::exp(twist);
            let (made, truth) = (here.seen_from(&camera, &there), corner(&camera, &there));
            let known: Vec<usize> = (0..1200).filter(|pixel| made.is_known(*pixel)).collect();
            let right = known
                .iter()
                .filter(|pixel| (made.depth()[**pixel] / truth.depth()[**pixel] - 1.0).abs() < 0.05)
                .count();
            assert!(known.len() >= least_known, "{twist:?}: {} known", known.len());
            assert!(right * 100 >= known.len() * 95, "{twist:?}: {right} of {} are right", known.len());
            let unknown = (0..1200).filter(|pixel| !made.is_known(*pixel));
            assert!(unknown.into_iter().all(|pixel| made.depth()[pixel] == 0.0));
        }
    }

    #[test]
    fn what_is_nearer_hides_what_is_behind_and_colour_moves_along() {
        let camera = Intrinsics::new(9, 1, 8.0, 8.0, 4.0, 0.0);
        // Before a wall a post, and beside it nothing.
        let depth = Image::new(9, 1, vec![2.0, 2.0, 2.0, 2.0, 1.0, 2.0, 2.0, 0.0, 0.0]).unwrap();
        let colour = Image::from_fn(9, 1, |x, _| [10 * x as u8 + 1, 0, 0, 255]);
        let view = SmallView::new(depth, Some(colour)).unwrap();
        assert!(view.is_whole());
        // A step aside by a quarter of a metre: the wall moves by a pixel, and the post by two.
        let aside = view.seen_from(&camera, &Se3::exp([0.25, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(!aside.is_whole());
        let colours: Vec<u8> = aside.colour().unwrap().iter().map(|colour| colour[0]).collect();
        assert_eq!(colours[2], 41, "the post: {colours:?}");
        assert!((aside.depth()[2] - 1.0).abs() < 0.3 && aside.depth()[1] > 1.6, "{:?}", aside.depth());
        assert!(aside.is_known(6) && aside.depth()[6] == 0.0, "nothing is still nothing");
        assert!(!aside.is_known(8) && colours[8] == 0, "what comes into view is not known");
    }

    #[test]
    fn of_an_empty_view_nothing_is_known_and_steep_edges_stay_before_the_camera() {
        let camera = Intrinsics::new(2, 2, 2.0, 2.0, 0.5, 0.5);
        let back = Se3::exp([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]);
        let empty = SmallView::new(Image::filled(2, 2, 0.0), None).unwrap().seen_from(&camera, &back);
        assert!((0..4).all(|pixel| !empty.is_known(pixel)));
        let edge = Image::new(2, 2, vec![0.1, 9.0, 0.1, 9.0]).unwrap();
        let edge = SmallView::new(edge, None).unwrap().seen_from(&camera, &back);
        assert!(edge.depth().iter().all(|depth| *depth == 0.0 || *depth > 1.0), "{:?}", edge.depth());
    }

    #[test]
    fn colour_must_fit_the_depth() {
        let colour = Image::filled(1, 2, [9, 9, 9, 0]);
        let error = SmallView::new(Image::filled(2, 1, 1.0), Some(colour.clone())).unwrap_err();
        assert_eq!(error, Error::ViewSize { what: "colour", expected: (2, 1), found: (1, 2) });
        let view = SmallView::new(Image::filled(1, 2, 1.0), Some(colour)).unwrap();
        assert_eq!((view.depth_share(), view.colour_share()), (1.0, 0.0));
    }
}
