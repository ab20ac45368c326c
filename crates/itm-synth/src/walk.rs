//! Long ways with a purpose: closing loops, being led astray, being carried off.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use glam::{DQuat, DVec3};
use itm_core::Se3;

use crate::rooms::{PITCH_M, ROOMS, room_middle};
use crate::route::{Pace, Place, Route};

/// Height of the camera above the floor in metres.
const HEIGHT: f64 = 1.4;

/// There and back along [`Scene::corridor`](crate::Scene::corridor), looking now at the one wall, now at the other.
static CORRIDOR: LazyLock<Route> = LazyLock::new(|| {
    const END: f64 = 13.3;
    // Where along x, and how many degrees to the right of straight ahead the camera looks there.
    let stops = [
        (-12.1, 14.0),
        (-9.9, -17.0),
        (-8.0, 9.0),
        (-5.6, 20.0),
        (-3.4, -12.0),
        (-0.8, 16.0),
        (1.1, -20.0),
        (3.9, 10.0),
        (5.8, -9.0),
        (8.3, 18.0),
        (10.2, -16.0),
        (12.0, 6.0),
    ];
    let place = |x: f64, yaw: f64| Place::new((x, 0.12 * (0.9 * x).sin()), HEIGHT, yaw, -12.0);
    let mut places = vec![place(-END, 90.0)];
    places.extend(stops.iter().map(|&(x, aside)| place(x, 90.0 + aside)));
    // A turn on the spot, by the wall at +z, and back along the way.
    places.extend([place(END, 90.0), place(END, -90.0)]);
    places.extend(stops.iter().rev().map(|&(x, aside)| place(x, -90.0 - 0.8 * aside)));
    places.extend([place(-END, -90.0), place(-END, 90.0)]);
    Route::new(&places, Pace { m_per_s: 0.7, degrees_per_s: 40.0 })
});

/// Through [`Scene::rooms`](crate::Scene::rooms), the same way in each.
static ROOMS_ROUTE: LazyLock<Route> = LazyLock::new(|| {
    let place =
        |room: usize, x: f64, z: f64, yaw: f64| Place::new((f64::from(room_middle(room)) + x, z), HEIGHT, yaw, -12.0);
    let half_pitch = 0.5 * f64::from(PITCH_M);
    let mut places = Vec::new();
    for room in 0..ROOMS {
        if room > 0 {
            places.push(place(room, -half_pitch, -0.6, 85.0));
        }
        places.extend([place(room, -0.7, -0.6, 60.0), place(room, 0.1, -0.65, -35.0), place(room, 0.6, -0.6, 50.0)]);
    }
    Route::new(&places, Pace { m_per_s: 0.6, degrees_per_s: 42.0 })
});

/// In [`Scene::room`](crate::Scene::room) from one place to another and back, looking around at both.
static KIDNAPPED: LazyLock<Route> = LazyLock::new(|| {
    let here = |yaw: f64| Place::new((-0.56, 0.02), 1.4, yaw, -12.0);
    let there = |yaw: f64| Place::new((0.55, -0.08), 1.45, yaw, -14.0);
    let before = [here(-60.0), here(-10.0), there(90.0), there(140.0)];
    let after = [here(-50.0), here(-10.0), here(-65.0), here(-15.0), here(-60.0)];
    let places = [&before[..], &after].concat();
    Route::new(&places, Pace { m_per_s: 0.4, degrees_per_s: 40.0 })
});

/// [`Path::Corridor`](crate::Path::Corridor) after a share of its time.
pub(crate) fn corridor(share: f64) -> Se3 {
    pose(CORRIDOR.at(share), share, 50.0)
}

/// [`Path::Rooms`](crate::Path::Rooms) after a share of its time.
pub(crate) fn rooms(share: f64) -> Se3 {
    // The same sway in every room would need all of them to take equally long; without any, they look the same.
    pose(ROOMS_ROUTE.at(share), 0.0, 0.0)
}

/// [`Path::Kidnapped`](crate::Path::Kidnapped) after a share of its time.
pub(crate) fn kidnapped(share: f64) -> Se3 {
    pose(KIDNAPPED.at(share), share, 3.0)
}

/// Share of the time of [`Path::Kidnapped`](crate::Path::Kidnapped) in which the lens is covered: on the way back.
pub(crate) const KIDNAPPED_DURING: [f64; 2] = [0.37, 0.64];

/// [`Path::Eight`](crate::Path::Eight) at an angle that grows with time: a lemniscate (Gerono's) around the tables of
/// [`Scene::two_rooms`](crate::Scene::two_rooms), looking where it leads, and a little to either side.
pub(crate) fn eight(a: f64) -> Se3 {
    const LONG_M: f64 = 3.7;
    const WIDE_M: f64 = 1.45;
    let position = DVec3::new(LONG_M * a.sin(), -HEIGHT - 0.03 * (5.0 * a).sin(), -WIDE_M * (2.0 * a).sin());
    // Never towards -z, where angles jump.
    let (east, north) = (LONG_M * a.cos(), -2.0 * WIDE_M * (2.0 * a).cos());
    let yaw = east.atan2(north) + 0.15 * (3.0 * a).sin();
    look(position, yaw, -0.2 + 0.04 * (4.0 * a).sin(), 0.02 * (6.0 * a).sin())
}

/// A place on a route with the sway of somebody who walks, of so many steps.
fn pose(place: Place, share: f64, steps: f64) -> Se3 {
    // At rest at both ends.
    let sway = |cycles: f64| 0.5 * ((TAU * cycles * share).cos() - (TAU * (cycles + 1.0) * share).cos());
    let position = place.position + DVec3::Y * 0.015 * sway(steps);
    look(position, place.yaw, place.pitch, 0.02 * sway((0.5 * steps).floor()))
}

/// A camera at a position that looks along +z turned by `yaw` to the right, then by `pitch` upwards, and is then
/// rolled clockwise by `roll`.
pub(crate) fn look(position: DVec3, yaw: f64, pitch: f64, roll: f64) -> Se3 {
    let rotation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch) * DQuat::from_rotation_z(roll);
    Se3::new(rotation, position)
}
