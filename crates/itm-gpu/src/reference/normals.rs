//! Reference of stage `normals`: normals of a raycast image, from neighbouring points (the report, section 3.4).

use glam::DVec3;
use itm_core::Image;

/// Points further than this apart (metres) belong to different surfaces.
pub const EDGE_M: f64 = 0.15;

/// Normals of points (world frame, metres) seen from `camera`: unit length, world frame, towards the camera.
///
/// They come from differences of the points two pixels to either side; where one of those is missing or the difference
/// reaches over [`EDGE_M`], from those one pixel to either side; `None` where one of those is missing too. `margin_m` adds
/// to [`EDGE_M`].
pub fn normals(points: &Image<Option<DVec3>>, camera: DVec3, margin_m: f64) -> Image<Option<DVec3>> {
    Image::from_fn(points.width(), points.height(), |x, y| {
        let point = points[(x, y)]?;
        let limit = EDGE_M + margin_m;
        let [along_x, along_y] = differences(points, x, y, 2)
            .filter(|differences| differences.iter().all(|d| d.length() <= limit))
            .or_else(|| differences(points, x, y, 1))?;
        let normal = along_x.cross(along_y).try_normalize()?;
        Some(if normal.dot(camera - point) < 0.0 { -normal } else { normal })
    })
}

/// The vectors from the point `reach` pixels to the left to that as far to the right, and from above to below.
fn differences(points: &Image<Option<DVec3>>, x: u32, y: u32, reach: u32) -> Option<[DVec3; 2]> {
    let at = |x, y| points.get(x, y).copied().flatten();
    let along_x = at(x + reach, y)? - at(x.checked_sub(reach)?, y)?;
    let along_y = at(x, y + reach)? - at(x, y.checked_sub(reach)?)?;
    Some([along_x, along_y])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_floor_seen_from_above_points_up_and_edges_keep_their_sides() {
        // y points down. A floor at y = 1 with a step of 1 m at column 5.
        let points = Image::from_fn(10, 7, |x, y| {
            let height = if x < 5 { 1.0 } else { 2.0 };
            (x > 0).then(|| DVec3::new(f64::from(x) * 0.03, height, -f64::from(y) * 0.03))
        });
        let normals = normals(&points, DVec3::ZERO, 0.0);
        assert_eq!(normals[(0, 3)], None, "no point");
        assert_eq!(normals[(1, 3)], None, "no left neighbour");
        assert_eq!(normals[(9, 3)], None, "no right neighbour");
        for x in [2, 3, 6, 7, 8] {
            assert!(normals[(x, 3)].unwrap().abs_diff_eq(DVec3::NEG_Y, 1e-12), "column {x}");
        }
    }
}
