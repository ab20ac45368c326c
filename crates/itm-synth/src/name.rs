//! Scenes by name.

use std::fmt;
use std::str::FromStr;

use crate::{Error, Scene};

/// The scenes that come with this crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SceneName {
    /// [`Scene::room`].
    Room,
    /// [`Scene::hall`].
    Hall,
    /// [`Scene::wall`].
    Wall,
    /// [`Scene::blank_wall`].
    BlankWall,
    /// [`Scene::corridor`].
    Corridor,
    /// [`Scene::two_rooms`].
    TwoRooms,
    /// [`Scene::rooms`].
    Rooms,
}

impl SceneName {
    /// Every scene.
    pub const ALL: [Self; 7] =
        [Self::Room, Self::Hall, Self::Wall, Self::BlankWall, Self::Corridor, Self::TwoRooms, Self::Rooms];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Room => "room",
            Self::Hall => "hall",
            Self::Wall => "wall",
            Self::BlankWall => "blank-wall",
            Self::Corridor => "corridor",
            Self::TwoRooms => "two-rooms",
            Self::Rooms => "rooms",
        }
    }

    /// Makes the scene.
    pub fn scene(self) -> Scene {
        match self {
            Self::Room => Scene::room(),
            Self::Hall => Scene::hall(),
            Self::Wall => Scene::wall(),
            Self::BlankWall => Scene::blank_wall(),
            Self::Corridor => Scene::corridor(),
            Self::TwoRooms => Scene::two_rooms(),
            Self::Rooms => Scene::rooms(),
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for SceneName {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|s| s.name() == name).ok_or_else(|| Error::UnknownScene { found: name.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        for scene in SceneName::ALL {
            assert_eq!(scene.to_string().parse::<SceneName>().unwrap(), scene);
        }
        let error = "garden".parse::<SceneName>().unwrap_err().to_string();
        assert!(error.contains("garden") && error.contains("blank-wall"), "{error}");
    }
}
