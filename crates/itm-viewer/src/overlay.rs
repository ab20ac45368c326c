//! What is drawn over the picture of the map: trajectory, cameras, submaps.

use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke, StrokeKind, Vec2};
use glam::DVec3;
use itm_slam::{Intrinsics, Se3};

/// Nearest depth at which lines are drawn, in metres.
const NEAR_M: f64 = 0.02;

/// Where points of the world are in a pane that shows a camera's picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projection {
    camera: Intrinsics,
    camera_from_world: Se3,
    pane: Rect,
}

impl Projection {
    /// Of a camera whose picture fills a pane.
    pub(crate) fn new(camera: &Intrinsics, world_from_camera: &Se3, pane: Rect) -> Self {
        Self { camera: *camera, camera_from_world: world_from_camera.inverse(), pane }
    }

    /// Where a pixel lies in the pane.
    fn place(&self, pixel: glam::DVec2) -> Pos2 {
        let scale =
            Vec2::new(self.pane.width() / self.camera.width as f32, self.pane.height() / self.camera.height as f32);
        self.pane.min + scale * Vec2::new(pixel.x as f32 + 0.5, pixel.y as f32 + 0.5)
    }

    /// Where a point of the world is; `None` behind the camera.
    pub(crate) fn point(&self, world: DVec3) -> Option<Pos2> {
        let seen = self.camera_from_world.transform_point(world);
        (seen.z > NEAR_M).then(|| self.camera.project(seen)).flatten().map(|pixel| self.place(pixel))
    }

    /// The part of a line that is in front of the camera.
    pub(crate) fn line(&self, from: DVec3, to: DVec3) -> Option<[Pos2; 2]> {
        let [a, b] = [from, to].map(|p| self.camera_from_world.transform_point(p));
        let clipped =
            |near: DVec3, far: DVec3| near + (far - near) * ((NEAR_M - near.z) / (far.z - near.z)) + DVec3::Z * 1e-9;
        let (a, b) = match (a.z > NEAR_M, b.z > NEAR_M) {
            (false, false) => return None,
            (true, true) => (a, b),
            (false, true) => (clipped(a, b), b),
            (true, false) => (a, clipped(b, a)),
        };
        Some([self.place(self.camera.project(a)?), self.place(self.camera.project(b)?)])
    }

    /// The pixel at a place in the pane; `None` outside.
    pub(crate) fn pixel(&self, place: Pos2) -> Option<(u32, u32)> {
        let share = (place - self.pane.min) / self.pane.size();
        let inside = self.pane.contains(place) && share.x < 1.0 && share.y < 1.0;
        inside.then_some(((share.x * self.camera.width as f32) as u32, (share.y * self.camera.height as f32) as u32))
    }
}

/// Draws over a picture.
pub(crate) struct Overlay<'a> {
    painter: &'a Painter,
    projection: Projection,
}

impl<'a> Overlay<'a> {
    pub(crate) fn new(painter: &'a Painter, projection: Projection) -> Self {
        Self { painter, projection }
    }

    /// A line through points, with a dark edge, so that it shows on light and dark.
    pub(crate) fn path(&self, points: &[DVec3], colour: Color32, width: f32) {
        let mut run: Vec<Pos2> = Vec::new();
        let mut runs = Vec::new();
        for pair in points.windows(2) {
            match self.projection.line(pair[0], pair[1]) {
                Some([a, b]) => {
                    if run.last().is_none_or(|last| last.distance(a) > 0.5) {
                        runs.push(std::mem::take(&mut run));
                        run.push(a);
                    }
                    // What would fall into one pixel is left out.
                    if run.last().is_none_or(|last| last.distance(b) > 0.75) {
                        run.push(b);
                    }
                }
                None => runs.push(std::mem::take(&mut run)),
            }
        }
        runs.push(run);
        for (width, colour) in [(width + 2.0, Color32::from_black_alpha(110)), (width, colour)] {
            for run in runs.iter().filter(|run| run.len() > 1) {
                self.painter.line(run.clone(), Stroke::new(width, colour));
            }
        }
    }

    /// The edges of what a camera sees up to a depth.
    pub(crate) fn frustum(&self, camera: &Intrinsics, world_from_camera: &Se3, depth_m: f64, stroke: Stroke) {
        let (right, bottom) = (f64::from(camera.width) - 0.5, f64::from(camera.height) - 0.5);
        let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)]
            .map(|(x, y)| world_from_camera.transform_point(camera.unproject(glam::DVec2::new(x, y), depth_m)));
        let centre = world_from_camera.translation;
        for i in 0..4 {
            self.segment(centre, corners[i], stroke);
            self.segment(corners[i], corners[(i + 1) % 4], stroke);
        }
        // Which side is up.
        let above = |share: f64| corners[0].lerp(corners[1], share) + (corners[0] - corners[3]) * 0.18;
        let middle = above(0.5);
        self.segment(corners[0].lerp(corners[1], 0.35), middle, stroke);
        self.segment(corners[0].lerp(corners[1], 0.65), middle, stroke);
    }

    /// A line.
    pub(crate) fn segment(&self, from: DVec3, to: DVec3, stroke: Stroke) {
        if let Some(ends) = self.projection.line(from, to) {
            self.painter.line_segment(ends, stroke);
        }
    }

    /// A name at a place.
    pub(crate) fn label(&self, at: DVec3, text: &str, colour: Color32) {
        if let Some(place) = self.projection.point(at) {
            let font = FontId::proportional(12.0);
            let shadow = Color32::from_black_alpha(200);
            self.painter.text(place + Vec2::new(7.0, 1.0), Align2::LEFT_CENTER, text, font.clone(), shadow);
            self.painter.text(place + Vec2::new(6.0, 0.0), Align2::LEFT_CENTER, text, font, colour);
        }
    }

    /// A dot.
    pub(crate) fn dot(&self, at: DVec3, radius: f32, colour: Color32) {
        if let Some(place) = self.projection.point(at) {
            self.painter.circle(place, radius, colour, Stroke::new(1.0, Color32::from_black_alpha(160)));
        }
    }

    /// A cross at a place, as long as it is looked at.
    pub(crate) fn cross(&self, at: DVec3, length_m: f64) {
        for (axis, colour) in axes() {
            self.segment(at - axis * length_m, at + axis * length_m, Stroke::new(1.5, colour));
        }
    }
}

/// The world's axes in a corner of the pane.
pub(crate) fn axes_in_corner(painter: &Painter, pane: Rect, world_from_camera: &Se3) {
    let middle = pane.left_bottom() + Vec2::new(34.0, -34.0);
    painter.circle_filled(middle, 28.0, Color32::from_black_alpha(70));
    let camera_from_world = world_from_camera.rotation.inverse();
    let mut ends: Vec<_> = axes().iter().map(|(axis, colour)| (camera_from_world * *axis, *colour)).collect();
    ends.sort_by(|a, b| b.0.z.total_cmp(&a.0.z));
    for (end, colour) in ends {
        let tip = middle + 22.0 * Vec2::new(end.x as f32, end.y as f32);
        painter.line_segment([middle, tip], Stroke::new(2.0, colour));
        painter.circle_filled(tip, 3.0, colour);
    }
}

fn axes() -> [(DVec3, Color32); 3] {
    [
        (DVec3::X, Color32::from_rgb(230, 80, 70)),
        (DVec3::Y, Color32::from_rgb(110, 190, 80)),
        (DVec3::Z, Color32::from_rgb(80, 140, 240)),
    ]
}

/// A frame around the pane.
pub(crate) fn border(painter: &Painter, pane: Rect, colour: Color32) {
    painter.rect_stroke(pane, 0.0, Stroke::new(3.0, colour), StrokeKind::Inside);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn projection() -> Projection {
        let camera = Intrinsics::new(100, 80, 50.0, 50.0, 49.5, 39.5);
        Projection::new(&camera, &Se3::IDENTITY, Rect::from_min_size(Pos2::new(10.0, 20.0), Vec2::new(200.0, 160.0)))
    }

    #[test]
    fn what_is_on_the_axis_is_in_the_middle_and_its_pixel_leads_back() {
        let projection = projection();
        let middle = projection.point(DVec3::Z).unwrap();
        assert!(middle.distance(Pos2::new(110.0, 100.0)) < 1e-3, "{middle:?}");
        assert_eq!(projection.pixel(middle), Some((50, 40)));
        assert_eq!(projection.pixel(Pos2::new(9.0, 50.0)), None);
        assert_eq!(projection.pixel(Pos2::new(210.0, 180.0)), None);
        assert!(projection.point(-DVec3::Z).is_none());
    }

    #[test]
    fn lines_end_at_the_camera() {
        let projection = projection();
        let [a, b] = projection.line(DVec3::new(0.01, 0.0, -1.0), DVec3::new(0.0, 0.0, 1.0)).unwrap();
        assert!(a.is_finite() && b.distance(Pos2::new(110.0, 100.0)) < 1e-3, "{a:?} {b:?}");
        assert!(projection.line(-DVec3::Z, DVec3::new(1.0, 0.0, -2.0)).is_none());
    }
}
