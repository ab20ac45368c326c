//! The pinhole camera.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// A pinhole camera: image size and focal lengths and principal point in pixels.
///
/// Pixel `(0, 0)` is the centre of the upper left pixel. `fy` may be negative: ICL-NUIM's camera has its y axis
/// pointing up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels; negative where the camera's y axis points up.
    pub fy: f64,
    /// Principal point, x, in pixels.
    pub cx: f64,
    /// Principal point, y, in pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// A camera from its image size, focal lengths and principal point, in pixels.
    pub const fn new(width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self { width, height, fx, fy, cx, cy }
    }

    /// Pixel of a point in camera coordinates (metres), or `None` where it is not in front of the camera. The pixel
    /// may lie outside the image.
    pub fn project(&self, point_camera: DVec3) -> Option<DVec2> {
        (point_camera.z > 0.0).then(|| {
            DVec2::new(
                self.fx * point_camera.x / point_camera.z + self.cx,
                self.fy * point_camera.y / point_camera.z + self.cy,
            )
        })
    }

    /// Point in camera coordinates (metres) that a pixel sees at depth `z` (metres, along the optical axis).
    pub fn unproject(&self, pixel: DVec2, z: f64) -> DVec3 {
        DVec3::new((pixel.x - self.cx) / self.fx * z, (pixel.y - self.cy) / self.fy * z, z)
    }

    /// Inward unit normals of the planes through the camera's centre and the image's four sides (camera frame).
    pub fn frustum_sides(&self) -> [DVec3; 4] {
        let (w, h) = (f64::from(self.width) - 0.5, f64::from(self.height) - 0.5);
        let corner = |x, y| self.unproject(DVec2::new(x, y), 1.0);
        let corners = [corner(-0.5, -0.5), corner(w, -0.5), corner(w, h), corner(-0.5, h)];
        let middle = corners.iter().sum::<DVec3>();
        std::array::from_fn(|i| {
            let normal = corners[i].cross(corners[(i + 1) % 4]).normalize();
            if normal.dot(middle) < 0.0 { -normal } else { normal }
        })
    }

    /// The camera whose image has been halved `level` times by averaging 2x2 pixels; odd last rows and columns are
    /// dropped, and no side gets smaller than one pixel.
    pub fn at_level(&self, level: u32) -> Self {
        let mut camera = *self;
        for _ in 0..level {
            camera = Self {
                width: (camera.width / 2).max(1),
                height: (camera.height / 2).max(1),
                fx: camera.fx / 2.0,
                fy: camera.fy / 2.0,
                // The centre of a coarse pixel lies between its two fine ones.
                cx: (camera.cx - 0.5) / 2.0,
                cy: (camera.cy - 0.5) / 2.0,
            };
        }
        camera
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The same camera with its image scaled to another size.
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: (self.cx + 0.5) * sx - 0.5,
            cy: (self.cy + 0.5) * sy - 0.5,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projection_undoes_unprojection_also_with_negative_fy() {
        let camera = Intrinsics::new(640, 480, 481.2, -480.0, 319.5, 239.5);
        let pixel = DVec2::new(12.25, 401.5);
        let point = camera.unproject(pixel, 2.5);
        assert!(point.y < 0.0, "below the centre of the image is down, which is -y here");
        assert!(camera.project(point).unwrap().abs_diff_eq(pixel, 1e-9));
        assert_eq!(camera.project(-point), None);
    }

    #[test]
    fn a_coarse_pixel_sees_what_its_four_fine_pixels_see() {
        let camera = Intrinsics::new(641, 479, 500.0, 510.0, 320.0, 240.0);
        let coarse = camera.at_level(1);
        assert_eq!((coarse.width, coarse.height), (320, 239));
        let fine = camera.unproject(DVec2::new(20.5, 30.5), 1.0);
        assert!(coarse.unproject(DVec2::new(10.0, 15.0), 1.0).abs_diff_eq(fine, 1e-12));
        assert_eq!(Intrinsics::new(1, 1, 1.0, 1.0, 0.0, 0.0).at_level(3).pixels(), 1);
    }
}
