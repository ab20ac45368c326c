//! A scene: solids with materials, lamps, and the distance from anywhere to the nearest surface.

use std::sync::Arc;

use glam::{IVec3, Mat3, Quat, Vec3};

use crate::{Material, Shape};

/// A box with sides along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates in metres.
    pub min: Vec3,
    /// Largest coordinates in metres.
    pub max: Vec3,
}

impl Bounds {
    /// A box from its two extreme corners, in metres.
    pub const fn new(min: Vec3, max: Vec3) -> Self {
        Self { min, max }
    }

    /// Whether a point lies inside or on the boundary.
    pub fn contains(&self, p: Vec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// Middle.
    pub fn centre(&self) -> Vec3 {
        0.5 * (self.min + self.max)
    }
}

/// A solid somewhere in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    shape: Shape,
    material: Material,
    centre: Vec3,
    local_from_world: Mat3,
    /// Tells the noise of objects of the same material apart.
    seed: u32,
}

impl Object {
    /// A solid at the world's origin.
    pub fn new(shape: Shape, material: impl Into<Material>) -> Self {
        let material = material.into();
        Self { shape, material, centre: Vec3::ZERO, local_from_world: Mat3::IDENTITY, seed: 0 }
    }

    /// The same solid with its origin moved to a point of the world, in metres.
    pub fn at(mut self, x: f32, y: f32, z: f32) -> Self {
        self.centre = Vec3::new(x, y, z);
        self
    }

    /// The same solid turned about its own origin by `world_from_local`.
    pub fn turned(mut self, world_from_local: Quat) -> Self {
        self.local_from_world = Mat3::from_quat(world_from_local.normalize().conjugate());
        self
    }

    /// The same solid with noise of its own.
    pub fn seeded(mut self, seed: u32) -> Self {
        self.seed = seed;
        self
    }

    /// The same solid taken along by a motion of the world: turned by `turn`, so that what was at `from` is at `to`.
    pub(crate) fn moved(mut self, from: Vec3, to: Vec3, turn: Quat) -> Self {
        self.centre = to + turn * (self.centre - from);
        self.local_from_world *= Mat3::from_quat(turn.conjugate());
        self
    }

    fn to_local(self, p: Vec3) -> Vec3 {
        self.local_from_world * (p - self.centre)
    }

    fn distance(&self, p: Vec3) -> f32 {
        self.shape.distance(self.local_from_world * (p - self.centre))
    }

    pub(crate) fn normal(&self, p: Vec3) -> Vec3 {
        self.local_from_world.transpose() * self.shape.gradient(self.to_local(p))
    }

    pub(crate) fn albedo(&self, p: Vec3, normal: Vec3) -> Vec3 {
        let local = self.to_local(p);
        let uv = self.shape.surface_coordinates(local, self.local_from_world * normal);
        self.material.albedo(local, uv, self.seed)
    }

    pub(crate) fn glow(&self) -> f32 {
        self.material.glow
    }
}

/// A lamp without size, as bright in every direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Where, in metres.
    pub position: Vec3,
    /// Light on a surface that faces it one metre away, for red, green, blue; 1 shows a surface in its own colour.
    pub power: Vec3,
}

/// What is known of a scene at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Signed distance to the nearest surface in metres; see [`Scene::distance`].
    pub distance: f32,
    /// Unit direction away from that surface.
    pub normal: Vec3,
    /// The share of red, green and blue that the nearest surface sends back, in linear light.
    pub albedo: Vec3,
    /// The nearest object, counted as they were given to [`Scene::new`].
    pub object: usize,
}

/// Solids and lamps.
///
/// The world is in metres with **y pointing down**, like the camera's: what is upright has its top at the smaller y.
///
/// Within [`Scene::bounds`] a grid knows for each cell which objects can be nearest there, so that a query costs a few
/// objects rather than all. It changes no result: an object is left out of a cell only where another one is nearer at
/// every point of it.
#[derive(Clone, Debug)]
pub struct Scene {
    objects: Vec<Object>,
    lamps: Vec<Lamp>,
    bounds: Bounds,
    grid: Arc<Grid>,
    /// Objects that the grid knows; those behind them are asked each time.
    in_grid: usize,
}

impl Scene {
    /// A scene from its objects, lit evenly from all sides.
    ///
    /// `bounds` is where the scene takes place: queries are fast there, and a mesh of the scene covers it. Objects may
    /// reach beyond.
    pub fn new(objects: Vec<Object>, bounds: Bounds) -> Self {
        let grid = Arc::new(Grid::new(&objects, &bounds));
        let in_grid = objects.len();
        Self { objects, lamps: Vec::new(), bounds, grid, in_grid }
    }

    /// The same scene with further objects, such as some that move: this is quick, but each of them makes all queries slower.
    pub fn and(&self, objects: impl IntoIterator<Item = Object>) -> Self {
        let mut scene = self.clone();
        scene.objects.extend(objects);
        scene
    }

    /// The same scene with lamps.
    pub fn with_lamps(mut self, lamps: Vec<Lamp>) -> Self {
        self.lamps = lamps;
        self
    }

    /// Where the scene takes place.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The objects.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    pub(crate) fn lamps(&self) -> &[Lamp] {
        &self.lamps
    }

    /// Signed distance in metres from a point to the nearest surface; infinite in an empty scene.
    ///
    /// Exact outside of all objects. Inside, where objects overlap, the surface may be farther away than it says, never
    /// nearer.
    pub fn distance(&self, p: Vec3) -> f32 {
        self.nearest(p).0
    }

    /// Distance, normal and colour of the nearest surface, or `None` in an empty scene.
    pub fn sample(&self, p: Vec3) -> Option<Sample> {
        let (distance, object) = self.nearest(p);
        let nearest = self.objects.get(object)?;
        let normal = nearest.normal(p);
        Some(Sample { distance, normal, albedo: nearest.albedo(p, normal), object })
    }

    /// Distance to the nearest object and its number, which is none of an object's in an empty scene.
    pub(crate) fn nearest(&self, p: Vec3) -> (f32, usize) {
        let mut best = (f32::INFINITY, usize::MAX);
        if let Some((candidates, from_centre)) = self.grid.candidates(p) {
            for candidate in candidates {
                // A distance changes by no more than the way gone; and the others are farther still.
                if candidate.distance_at_centre - from_centre > best.0 {
                    break;
                }
                let d = self.objects[candidate.object as usize].distance(p);
                if d < best.0 {
                    best = (d, candidate.object as usize);
                }
            }
            self.nearest_of(self.in_grid, p, best)
        } else {
            self.nearest_of(0, p, best)
        }
    }

    /// The nearest of the objects from one on and the best of others.
    fn nearest_of(&self, first: usize, p: Vec3, mut best: (f32, usize)) -> (f32, usize) {
        for (i, object) in self.objects.iter().enumerate().skip(first) {
            let d = object.distance(p);
            if d < best.0 {
                best = (d, i);
            }
        }
        best
    }
}

/// For each cell of a regular grid, the objects that can be nearest to a point in it.
#[derive(Clone, Debug)]
struct Grid {
    min: Vec3,
    cell_m: f32,
    cells_per_m: f32,
    size: IVec3,
    /// Where each cell's list starts and ends in `lists`.
    cells: Vec<[u32; 2]>,
    lists: Vec<Candidate>,
}

/// An object that can be nearest to a point in a cell.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    object: u32,
    /// Its distance in metres from the cell's centre, by which a cell's candidates are sorted.
    distance_at_centre: f32,
}

/// Added to bounds on distances, so that rounding leaves no object out.
const ROUNDING_M: f32 = 1e-4;

impl Grid {
    /// Edge of a cell in metres, unless there would be more than `MAX_CELLS`.
    const CELL_M: f32 = 0.125;
    const MAX_CELLS: f32 = 1e6;

    fn new(objects: &[Object], bounds: &Bounds) -> Self {
        let extent = (bounds.max - bounds.min).max(Vec3::splat(Self::CELL_M));
        let cell_m = Self::CELL_M.max((extent.element_product() / Self::MAX_CELLS).cbrt());
        // One more cell on each side: rays that end at a wall on the bounds end a rounding error beyond them.
        let min = bounds.min - cell_m;
        let size = (extent / cell_m).ceil().as_ivec3() + 2;
        let cells = vec![[0, 0]; size.element_product() as usize];
        let mut grid = Self { min, cell_m, cells_per_m: cell_m.recip(), size, cells, lists: Vec::new() };
        let all: Vec<u32> = (0..objects.len() as u32).collect();
        grid.fill(objects, IVec3::ZERO, size, &all);
        grid
    }

    /// Fills the cells from `lo` up to but without `hi`, whose nearest objects are all among `candidates`.
    fn fill(&mut self, objects: &[Object], lo: IVec3, hi: IVec3, candidates: &[u32]) {
        let cell_m = self.cell_m;
        let centre = self.min + 0.5 * (lo + hi).as_vec3() * cell_m;
        let radius = 0.5 * (hi - lo).as_vec3().length() * cell_m;
        let distances: Vec<f32> = candidates.iter().map(|&i| objects[i as usize].distance(centre)).collect();
        let nearest = distances.iter().copied().fold(f32::INFINITY, f32::min);
        // On the way from the centre to any point of the box, no distance changes by more than the radius; so what is
        // farther than the nearest by twice as much stays farther.
        let reach = nearest + 2.0 * radius + ROUNDING_M;
        let near = candidates.iter().zip(&distances).filter(|(_, d)| **d <= reach);
        let side = hi - lo;
        if side == IVec3::ONE {
            let start = self.lists.len();
            self.lists.extend(near.map(|(&object, d)| Candidate { object, distance_at_centre: d - ROUNDING_M }));
            self.lists[start..].sort_by(|a, b| a.distance_at_centre.total_cmp(&b.distance_at_centre));
            let at = self.index(lo);
            self.cells[at] = [start as u32, self.lists.len() as u32];
            return;
        }
        let near: Vec<u32> = near.map(|(i, _)| *i).collect();
        let axis = if side.x >= side.y && side.x >= side.z {
            IVec3::X
        } else if side.y >= side.z {
            IVec3::Y
        } else {
            IVec3::Z
        };
        let half = (side / 2) * axis;
        self.fill(objects, lo, hi - side * axis + half, &near);
        self.fill(objects, lo + half, hi, &near);
    }

    fn index(&self, cell: IVec3) -> usize {
        (cell.x + self.size.x * (cell.y + self.size.y * cell.z)) as usize
    }

    /// Objects that can be nearest to a point, those nearest to the cell's centre first, and how far in metres the point
    /// is from that centre; or `None` outside of the grid.
    fn candidates(&self, p: Vec3) -> Option<(&[Candidate], f32)> {
        let in_cells = (p - self.min) * self.cells_per_m;
        let cell = in_cells.as_ivec3();
        if in_cells.cmplt(Vec3::ZERO).any() || cell.cmpge(self.size).any() {
            return None;
        }
        let from_centre = (in_cells - cell.as_vec3() - 0.5).length() * self.cell_m;
        let [start, end] = self.cells[self.index(cell)];
        Some((&self.lists[start as usize..end as usize], from_centre))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vec3> {
        (-2.8f32..2.8, -2.8f32..0.2, -2.2f32..2.2).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn the_grid_changes_no_distance(p in point()) {
            use std::sync::LazyLock;
            static ROOM: LazyLock<Scene> = LazyLock::new(Scene::room);
            let by_hand = ROOM.objects.iter().map(|o| o.distance(p)).fold(f32::INFINITY, f32::min);
            prop_assert_eq!(ROOM.distance(p), by_hand);
            let ball = Object::new(Shape::Sphere { radius: 0.2 }, Material::default()).at(0.3, -1.2, 0.1);
            prop_assert_eq!(ROOM.and([ball]).distance(p), by_hand.min(ball.distance(p)));
        }
    }

    #[test]
    fn objects_stand_where_they_are_put() {
        let bar = Object::new(Shape::cuboid(2.0, 0.2, 0.2), Material::default());
        let upright = bar.at(1.0, -1.0, 3.0).turned(Quat::from_rotation_z(std::f32::consts::FRAC_PI_2));
        let scene = Scene::new(vec![upright], Bounds::new(Vec3::splat(-4.0), Vec3::splat(4.0)));
        let above = scene.sample(Vec3::new(1.0, -2.5, 3.0)).unwrap();
        assert!((above.distance - 0.5).abs() < 1e-6, "the bar's end is two metres above the floor");
        assert!(above.normal.abs_diff_eq(-Vec3::Y, 1e-6));
        assert!((scene.distance(Vec3::new(2.0, -1.0, 3.0)) - 0.9).abs() < 1e-6);
    }

    #[test]
    fn an_empty_scene_is_far_from_everything() {
        let scene = Scene::new(Vec::new(), Bounds::new(Vec3::ZERO, Vec3::ONE));
        assert_eq!(scene.distance(Vec3::splat(0.5)), f32::INFINITY);
        assert_eq!(scene.sample(Vec3::splat(0.5)), None);
    }
}
