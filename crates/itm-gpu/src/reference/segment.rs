//! Reference of stage `segment`: what of a view moves, and what has left (Keller et al. 2013, *Real-time 3D Reconstruction in Dynamic
//! Scenes using Point-based Fusion*, section on dynamics).
//!
//! Margins (metres; also a cosine, and in pixels what so many metres are) move every border such that more is marked; negative ones
//! such that less is: what is marked grows with every mark before, so that the two enclose what is right.

use glam::DVec3;
use itm_core::surfel::Surfel;
use itm_core::{Image, Se3, SurfelSettings};

use super::associate::{Measured, Role, depth_deviation, window};
use crate::segment::CellMarks;

/// What was seen of the map: for each pixel a point (world frame, metres) and its confidence.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// The points.
    pub points: &'a Image<Option<(DVec3, f64)>>,
    /// The pose that they were seen from, by the camera of the view.
    pub world_from_model: &'a Se3,
}

/// A cell of an image.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// A place on what it shows (camera frame, metres), and the normal there.
    pub place: Option<(DVec3, DVec3)>,
    /// What was found of it.
    pub marks: CellMarks,
    /// Whether something in it is seen through.
    pub partly_vacant: bool,
}

/// Whether a point (camera frame, metres) stands in front of a stable part of what is known.
fn is_in_front(point: DVec3, measured: &Measured<'_>, known: &Known<'_>, margin_m: f64) -> bool {
    let model_from_world = known.world_from_model.inverse();
    let seen = model_from_world.transform_point(measured.world_from_camera.transform_point(point));
    let dynamics = &measured.settings.dynamics;
    let is_before = |pixel: (u32, u32)| {
        known.points.get(pixel.0, pixel.1).copied().flatten().is_some_and(|(behind, confidence)| {
            let z = model_from_world.transform_point(behind).z;
            let gate_m = f64::from(dynamics.gate_m) + f64::from(dynamics.gate_deviations) * depth_deviation(z);
            confidence >= measured.settings.stable.into() && z - seen.z > gate_m - margin_m
        })
    };
    let Some(pixel) = measured.camera.project(seen).filter(|_| seen.z > 0.0) else { return false };
    // Where it is not sure which pixel it is, any may do, or all must.
    let off = margin_m.abs() * measured.camera.fx.abs().max(measured.camera.fy.abs()) / seen.z;
    let mut around = [(-off, -off), (off, -off), (-off, off), (off, off)].into_iter().map(|(dx, dy)| {
        let (x, y) = ((pixel.x + dx + 0.5).floor(), (pixel.y + dy + 0.5).floor());
        x >= 0.0 && y >= 0.0 && is_before((x as u32, y as u32))
    });
    if margin_m >= 0.0 { around.any(|is| is) } else { around.all(|is| is) }
}

/// The finest cells: the middle's place, or else the first there is. `vacant` says which pixels see through a surfel.
fn finest(measured: &Measured<'_>, known: &Known<'_>, vacant: &[bool], margin_m: f64) -> Image<Cell> {
    let (camera, dynamics) = (measured.camera, &measured.settings.dynamics);
    let (width, height, side) = (camera.width, camera.height, dynamics.cell_px);
    Image::from_fn(width.div_ceil(side), height.div_ceil(side), |cx, cy| {
        let (x, y) = (cx * side, cy * side);
        let pixels = || (y..(y + side).min(height)).flat_map(move |v| (x..(x + side).min(width)).map(move |u| (u, v)));
        let place = |at: (u32, u32)| measured.vertices[at].zip(measured.normals[at]);
        let middle = ((x + side / 2).min(width - 1), (y + side / 2).min(height - 1));
        let place = place(middle).or_else(|| pixels().find_map(place));
        let count = |is: &dyn Fn((u32, u32), DVec3) -> bool| {
            pixels().filter(|at| measured.vertices[*at].is_some_and(|vertex| is(*at, vertex))).count() as f64
        };
        let measurements = count(&|_, _| true);
        // What moves is to be what the cell shows, or it would grow over what is behind.
        let is_shown = |vertex: DVec3| {
            place.is_some_and(|(place, normal): (DVec3, DVec3)| {
                normal.dot(vertex - place).abs() <= most_apart_m(place.z, measured.settings) + margin_m
            })
        };
        let in_front = count(&|_, vertex| is_shown(vertex) && is_in_front(vertex, measured, known, margin_m));
        let through = count(&|(x, y), _| vacant[(y * width + x) as usize]);
        let least = (f64::from(dynamics.min_share) * measurements - 1e-3 * margin_m.signum()).max(1.0);
        let marks = CellMarks { dynamic: in_front >= least, vacant: through >= least };
        Cell { place, marks, partly_vacant: through > 0.0 }
    })
}

/// The cells of which all around, within the image, are marked alike.
fn eroded(cells: &Image<Cell>) -> Image<Cell> {
    Image::from_fn(cells.width(), cells.height(), |x, y| {
        let all = |is: &dyn Fn(&Cell) -> bool| {
            let cell = |dx: u32, dy: u32| cells.get((x + dx).wrapping_sub(1), (y + dy).wrapping_sub(1));
            (0..3).all(|dy| (0..3).all(|dx| cell(dx, dy).is_some_and(is)))
        };
        let marks = CellMarks { dynamic: all(&|cell| cell.marks.dynamic), vacant: all(&|cell| cell.marks.vacant) };
        Cell { marks, ..cells[(x, y)] }
    })
}

/// Cells of twice the size: the first place of the four, and the marks of any, of those that are of one surface with it.
fn coarser(cells: &Image<Cell>, settings: &SurfelSettings, margin_m: f64) -> Image<Cell> {
    Image::from_fn(cells.width().div_ceil(2), cells.height().div_ceil(2), |x, y| {
        let last = (cells.width() - 1, cells.height() - 1);
        let four = || (0..4).map(|k| &cells[((2 * x + k % 2).min(last.0), (2 * y + k / 2).min(last.1))]);
        let shown = Cell { place: four().find_map(|cell| cell.place), ..Cell::default() };
        Cell {
            marks: CellMarks {
                dynamic: four().any(|cell| cell.marks.dynamic && is_alike(&shown, cell, settings, margin_m)),
                vacant: four().any(|cell| cell.marks.vacant),
            },
            partly_vacant: four().any(|cell| cell.partly_vacant),
            ..shown
        }
    })
}

/// Farthest, in metres, that a place at a depth lies from the plane of another of its surface.
fn most_apart_m(z: f64, settings: &SurfelSettings) -> f64 {
    let dynamics = &settings.dynamics;
    f64::from(dynamics.alike_m) + f64::from(dynamics.alike_deviations) * depth_deviation(z)
}

/// Whether two cells show one smooth surface: each one's place lies near the other's plane, and their normals are alike.
fn is_alike(a: &Cell, b: &Cell, settings: &SurfelSettings, margin_m: f64) -> bool {
    let (Some((a, normal_a)), Some((b, normal_b))) = (a.place, b.place) else { return false };
    let most_m = most_apart_m(a.z, settings) + margin_m;
    (b - a).dot(normal_a).abs() <= most_m
        && (b - a).dot(normal_b).abs() <= most_m
        && normal_a.dot(normal_b) >= f64::from(settings.dynamics.alike_rad).cos() - margin_m
}

/// One step of growing.
fn grown(cells: &Image<Cell>, settings: &SurfelSettings, margin_m: f64) -> Image<Cell> {
    Image::from_fn(cells.width(), cells.height(), |x, y| {
        let own = cells[(x, y)];
        let around =
            || (0..9_u32).filter_map(move |k| cells.get((x + k % 3).wrapping_sub(1), (y + k / 3).wrapping_sub(1)));
        let dynamic = around().any(|other| other.marks.dynamic && is_alike(&own, other, settings, margin_m));
        let vacant = own.partly_vacant && around().any(|other| other.marks.vacant);
        let marks = CellMarks { dynamic: own.marks.dynamic || dynamic, vacant: own.marks.vacant || vacant };
        Cell { marks, ..own }
    })
}

/// What of a view moves, and what has left, in cells of `surfels.dynamics.cell_px` pixels.
pub fn segment(measured: &Measured<'_>, known: &Known<'_>, vacant: &[bool], margin_m: f64) -> Image<Cell> {
    let settings = measured.settings;
    let dynamics = &settings.dynamics;
    let mut cells = finest(measured, known, vacant, margin_m);
    for _ in 0..dynamics.erosion {
        cells = eroded(&cells);
    }
    let mut levels = vec![cells];
    for _ in 1..dynamics.levels {
        levels.push(coarser(&levels[levels.len() - 1], settings, margin_m));
    }
    let mut coarse: Option<Image<Cell>> = None;
    for mut cells in levels.into_iter().rev() {
        if let Some(coarse) = coarse {
            cells = Image::from_fn(cells.width(), cells.height(), |x, y| {
                let (own, above) = (cells[(x, y)], coarse[(x / 2, y / 2)]);
                let dynamic = above.marks.dynamic && is_alike(&own, &above, settings, margin_m);
                Cell { marks: CellMarks { dynamic: own.marks.dynamic || dynamic, ..own.marks }, ..own }
            });
        }
        for _ in 0..dynamics.iterations {
            cells = grown(&cells, settings, margin_m);
        }
        coarse = Some(cells);
    }
    coarse.unwrap_or_else(|| Image::filled(1, 1, Cell::default()))
}

/// Which pixels see through a surfel that was seen more than once.
pub fn vacant(slots: &[Option<Surfel>], measured: &Measured<'_>) -> Vec<bool> {
    let mut vacant = vec![false; measured.camera.pixels()];
    let least = measured.settings.dynamics.fallen;
    for surfel in slots.iter().flatten().filter(|surfel| surfel.confidence >= least) {
        if let Some(Role::InFront(pixel)) = super::associate::role(surfel, measured, 0.0) {
            vacant[pixel] = true;
        }
    }
    vacant
}

/// Whether a surfel becomes unstable. The paper resets a stable one that is merged with what moves once its confidence is one more than it
/// must be, so that what has come to rest is stable for a frame, and agrees with what is tracked then. One that is seen through does
/// where that is so of most around it, and with it what no measurement says anything of, as where an object stood on the floor.
pub fn falls(surfel: &Surfel, role: Role, cells: &Image<Cell>, measured: &Measured<'_>, margin_m: f64) -> bool {
    let (settings, camera) = (measured.settings, measured.camera);
    let centre = measured.world_from_camera.inverse().transform_point(surfel.position.as_dvec3());
    let side = settings.dynamics.cell_px;
    let of_pixel = |pixel: usize| {
        let width = camera.width as usize;
        ((pixel % width) as u32 / side, (pixel / width) as u32 / side)
    };
    let is_vacant_near = |(x, y): (u32, u32)| {
        (0..9).any(|k| {
            let cell = cells.get((x + k % 3).wrapping_sub(1), (y + k / 3).wrapping_sub(1));
            cell.is_some_and(|cell| cell.marks.vacant)
        })
    };
    let depth_of = |at: (u32, u32)| cells[at].place.map(|(place, _)| place.z);
    let window_m = window(settings, centre.z) + margin_m;
    match role {
        Role::Forgotten => false,
        Role::None | Role::Refuted(_) => {
            let [near_m, far_m] = measured.depth_range_m.map(f64::from);
            let Some(pixel) = camera.project(centre).filter(|_| (near_m..=far_m).contains(&centre.z)) else {
                return false;
            };
            let pixel = (pixel + 0.5).floor();
            if pixel.x < 0.0 || pixel.y < 0.0 || pixel.x >= camera.width.into() || pixel.y >= camera.height.into() {
                return false;
            }
            let cell = (pixel.x as u32 / side, pixel.y as u32 / side);
            let is_above = cells[cell]
                .place
                .is_some_and(|(place, normal)| normal.dot(centre - place) > window(settings, centre.z) - margin_m);
            surfel.confidence >= settings.stable && is_above && is_vacant_near(cell)
        }
        Role::InFront(pixel) => surfel.confidence >= settings.stable && is_vacant_near(of_pixel(pixel)),
        Role::Competes(pixel) => {
            let is_of_cell = depth_of(of_pixel(pixel)).is_some_and(|z| (z - centre.z).abs() <= window_m);
            surfel.confidence >= settings.stable + 1.0 && cells[of_pixel(pixel)].marks.dynamic && is_of_cell
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec2, Vec3};
    use itm_core::Intrinsics;

    use super::*;

    /// A wall 2 m away with a board of 12 x 12 pixels before it, known as the wall alone, or as the wall with the board beside.
    #[test]
    fn a_board_before_a_known_wall_moves_all_of_it_and_nothing_else() {
        let camera = Intrinsics::new(40, 30, 40.0, 40.0, 19.5, 14.5);
        let settings = {
            let mut settings = SurfelSettings::default();
            settings.dynamics.cell_px = 2;
            settings
        };
        let at = |x: u32, y: u32, z: f64| camera.unproject(DVec2::new(x.into(), y.into()), z);
        let is_board = |x: u32, y: u32, left: u32| (left..left + 12).contains(&x) && (8..20).contains(&y);
        let depth = |x, y, left| if is_board(x, y, left) { 1.5 } else { 2.0 };
        let view = |left| Image::from_fn(40, 30, |x, y| Some(at(x, y, depth(x, y, left))));
        let normals = Image::filled(40, 30, Some(DVec3::NEG_Z));
        for (known_left, marked) in [(12, 0), (18, 36), (14, 0)] {
            let vertices = view(12);
            let measured = Measured {
                camera: &camera,
                world_from_camera: &Se3::IDENTITY,
                depth_range_m: [0.2, 4.0],
                vertices: &vertices,
                normals: &normals,
                settings: &settings,
                frame: 9,
            };
            // Where the board was, it is seen through: right of where it is.
            let points = Image::from_fn(40, 30, |x, y| Some((at(x, y, depth(x, y, known_left)), 20.0)));
            let known = Known { points: &points, world_from_model: &Se3::IDENTITY };
            let slots: Vec<Option<Surfel>> = (0..40 * 30)
                .map(|i| {
                    let position = points[(i % 40, i / 40)].unwrap().0.as_vec3();
                    let normal = Vec3::NEG_Z;
                    Some(Surfel {
                        position,
                        normal,
                        radius_m: 0.02,
                        submap: 0,
                        confidence: 20.0,
                        seen: 8,
                        colour: None,
                    })
                })
                .collect();
            let cells = segment(&measured, &known, &vacant(&slots, &measured), 0.0);
            let dynamic: Vec<_> = (0..cells.data().len()).filter(|i| cells.data()[*i].marks.dynamic).collect();
            assert_eq!(dynamic.len(), marked, "known at {known_left}");
            assert!(dynamic.iter().all(|i| is_board((2 * i % 40) as u32, (2 * (i / 20)) as u32, 12)));
            let vacated = cells.data().iter().filter(|cell| cell.marks.vacant).count();
            assert_eq!(vacated, if known_left == 18 { 18 } else { 0 });
            let role = |slot: &Surfel| super::super::associate::role(slot, &measured, 0.0).unwrap();
            let fallen = slots.iter().flatten().filter(|s| falls(s, role(s), &cells, &measured, 0.0));
            // The board's own surfels where it still is, and those where it was.
            assert_eq!(fallen.count(), if known_left == 18 { 12 * 12 } else { 0 });
        }
    }
}
