//! Saving a session in a map file, and going on from one.
//!
//! A file holds the map wherever its blocks lie, the trajectory, and all that the next frame depends on: a session that goes
//! on from it does, to the bit, what the one that was saved would have done. What was on its way between device and host is
//! read when the session is saved, and still taken over at its frame.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use itm_core::surfel::{SURFEL_WORDS, Surfel};
use itm_core::voxel::BlockKey;
use itm_core::{MapIndex, Se3, Settings, SubmapSettings};
use itm_gpu::swap::Left;
use itm_gpu::{Device, HostBlock, MapState, SurfelState};
use itm_io::map_file::{MapHeader, MapReader, MapWriter, Tag, tag};
use serde::{Deserialize, Serialize};

use crate::atlas::{Atlas, AtlasState, LeftOut};
use crate::local::{Local, LocalState};
use crate::mapper::MapperState;
use crate::submaps::{Beside, Life};
use crate::{Error, Poses, Slam, Warning};

/// What a session needs beside its map to go on.
const STATE: Tag = *b"STAT";
/// Of the device's block map, all but the voxels.
const COUNTERS: Tag = *b"CNTR";
const FREE_BLOCKS: Tag = *b"FREE";
const PENDING: Tag = *b"PEND";
const LAST_SEEN: Tag = *b"SEEN";
/// Blocks that have left the device but are not in the host's store yet.
pub(crate) const LEFT: Tag = *b"LEFT";
/// When blocks were last changed, where the settings ask for it: by block index; of stored blocks, as two words of a key and
/// one of the frame; of those that left.
const CHANGED: Tag = *b"CHNG";
const HOST_CHANGED: Tag = *b"CHHS";
const LEFT_CHANGED: Tag = *b"CHLF";
/// Blocks of the host's store that are on the device already; what counts is there.
const BACK: Tag = *b"BACK";
/// What is known of the submaps, links between them and the frames' poses in them.
const ATLAS: Tag = *b"ATLS";
/// Of a map of surfels their slots, the device's counters, and the free slots.
pub(crate) const SURFELS: Tag = *b"SURF";
const SURFEL_COUNTERS: Tag = *b"SFCN";
const FREE_SURFELS: Tag = *b"SFFR";
/// Keyframes, as the relocaliser writes them.
const KEYFRAMES: Tag = *b"KEYF";

/// The host's part of what a session needs beside its map.
#[derive(Debug, Serialize, Deserialize)]
struct State {
    poses_given: bool,
    next_frame: u64,
    primary: LocalState,
    beside: Vec<(LocalState, Life)>,
    next_look: u64,
    mapper: MapperState,
}

/// Of a saved session, what is to be known before a recording is opened for it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SavedSession {
    /// Its settings.
    pub settings: Settings,
    /// Its calibration.
    pub calibration: itm_core::Calibration,
    /// Where its poses come from.
    pub poses: Poses,
    /// The number of the frame that comes next, by its place in the recording.
    pub next_frame: u64,
}

impl SavedSession {
    /// Looks into a map file.
    ///
    /// # Errors
    /// Where it cannot be read, or holds a map but no session.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let mut reader = MapReader::open(path)?;
        let state = read_state(&mut reader, path)?;
        Ok(Self {
            settings: settings_of(reader.header(), path)?,
            calibration: reader.header().calibration,
            poses: if state.poses_given { Poses::Given } else { Poses::Tracked },
            next_frame: state.next_frame,
        })
    }
}

/// The settings that a map was made with.
///
/// # Errors
/// Where this version does not know them.
pub fn settings_of(header: &MapHeader, path: &Path) -> Result<Settings, Error> {
    Ok(Settings::resolve(Some((&format!("the settings in '{}'", path.display()), &header.settings)), &[])?)
}

fn unfit(path: &Path, section: Tag, reason: impl std::fmt::Display) -> Error {
    let reason = format!("section {}: {reason}", section.escape_ascii());
    Error::SavedState { path: path.to_path_buf(), reason }
}

fn read_state(reader: &mut MapReader, path: &Path) -> Result<State, Error> {
    if !reader.has(STATE) {
        let reason = "it holds a map, but no session that could go on; --map starts a new one in it".into();
        return Err(Error::SavedState { path: path.to_path_buf(), reason });
    }
    let text = String::from_utf8(reader.bytes(STATE)?).map_err(|e| unfit(path, STATE, e))?;
    toml::from_str(&text).map_err(|e| unfit(path, STATE, e.to_string().trim_end()))
}

/// The submaps as the file has them, and what of them is no use; without what is the session's own where another one begins.
fn read_atlas(
    reader: &mut MapReader,
    path: &Path,
    settings: &SubmapSettings,
    afresh: bool,
) -> Result<(AtlasState, Vec<LeftOut>), Error> {
    let text = String::from_utf8(reader.bytes(ATLAS)?).map_err(|e| unfit(path, ATLAS, e))?;
    let mut state: AtlasState = toml::from_str(&text).map_err(|e| unfit(path, ATLAS, e.to_string().trim_end()))?;
    if afresh {
        state.forget_session();
    }
    let left_out = state.check(settings).map_err(|reason| unfit(path, ATLAS, reason))?;
    Ok((state, left_out))
}

/// The sections of what the next frame is tracked against, in the primary submap and in those beside it: points and normals,
/// points with the colours of the frame before, and with those of the map.
fn sections_of(place: usize) -> [Tag; 3] {
    match u8::try_from(place) {
        Ok(0) | Err(_) => [*b"MODL", *b"LSTP", *b"LSTM"],
        Ok(place) => [b"MO", b"LP", b"LM"].map(|[a, b]| [*a, *b, b'0' + place / 10, b'0' + place % 10]),
    }
}

/// Why blocks of a submap are no use.
fn no_place(submap: u16) -> String {
    format!("there are blocks of submap {submap}, but nothing says where it lies in the world")
}

/// Numbers as bytes, least significant first.
fn to_bytes(words: impl IntoIterator<Item = u32>) -> Vec<u8> {
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}

fn to_words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// How many surfels a map file holds of each submap; nothing where it is one of voxels.
///
/// # Errors
/// Where the file cannot be read, or is damaged.
pub fn count_surfels(reader: &mut MapReader) -> Result<Option<BTreeMap<u16, u64>>, itm_io::Error> {
    if !reader.has(SURFELS) {
        return Ok(None);
    }
    let words = to_words(&reader.bytes(SURFELS)?);
    let (slots, _) = words.as_chunks::<SURFEL_WORDS>();
    let mut counts = BTreeMap::new();
    slots.iter().filter_map(|words| Surfel::from_words(*words)).for_each(|s| *counts.entry(s.submap).or_default() += 1);
    Ok(Some(counts))
}

/// The surfels of a file, empty slots included.
fn read_surfels(reader: &mut MapReader, path: &Path) -> Result<Vec<[u32; SURFEL_WORDS]>, Error> {
    let bytes = reader.bytes(SURFELS)?;
    if !bytes.len().is_multiple_of(4 * SURFEL_WORDS) {
        let reason = format!("{} bytes, which are not surfels of {} each", bytes.len(), 4 * SURFEL_WORDS);
        return Err(unfit(path, SURFELS, reason));
    }
    let slots: Vec<[u32; SURFEL_WORDS]> = to_words(&bytes).as_chunks().0.to_vec();
    // The other words mean something whatever they are.
    let is_sound = |words: &[u32; SURFEL_WORDS]| {
        let [x, y, z, confidence, ..] = words.map(f32::from_bits);
        [x, y, z, confidence].into_iter().all(f32::is_finite) && confidence >= 0.0
    };
    match slots.iter().position(|words| !is_sound(words)) {
        None => Ok(slots),
        Some(place) => Err(unfit(path, SURFELS, format!("surfel {place} has numbers that cannot be"))),
    }
}

fn pairs(words: &[u32]) -> Vec<[u32; 2]> {
    words.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
}

impl Slam {
    /// Saves the map, and all that is needed to go on as if nothing had been saved. The file takes its name only once it is
    /// whole: one of that name is replaced then, and stays as it is where that fails. Waits.
    ///
    /// # Errors
    /// Where the file cannot be written, or the device fails. The session can go on.
    pub fn save(&mut self, path: &Path) -> Result<(), Error> {
        let state = State {
            poses_given: self.poses == Poses::Given,
            next_frame: self.next_frame,
            primary: self.primary.state(),
            beside: self.beside.iter().map(|beside| (beside.local.state(), beside.life.clone())).collect(),
            next_look: self.next_look,
            mapper: self.mapper.state()?,
        };
        let on_device = self.mapper.map.read_state()?;
        let mut header = MapHeader::new(&self.settings, self.calibration, self.mapper.map.layout().kind);
        header.counts.frames = self.next_frame;
        header.counts.device_blocks = on_device.keys.iter().filter(|key| **key != BlockKey::NO_KEY).count() as u64;
        let superseded = self.mapper.superseded();
        let stored = self.mapper.swapped.as_ref().map_or(0, |swapped| swapped.store.len());
        header.counts.host_blocks = stored.saturating_sub(superseded.len()) as u64;

        let mut writer = MapWriter::create(path, &header)?;
        writer.blocks::<Error>(tag::BLOCKS, |sink| {
            self.mapper.map.read_blocks::<Error>(|key, words| {
                match key {
                    Some(key) => sink.block(key, words)?,
                    None => sink.unused()?,
                }
                Ok(())
            })
        })?;
        if let Some(surfels) = &self.mapper.surfels {
            let SurfelState { capacity: _, counters, free, slots } = surfels.map.read_state()?;
            writer.bytes(SURFELS, &to_bytes(slots.into_iter().flatten()))?;
            writer.bytes(SURFEL_COUNTERS, &to_bytes(counters))?;
            writer.bytes(FREE_SURFELS, &to_bytes(free))?;
        }
        if let Some(swapped) = &self.mapper.swapped {
            for (section, already_back) in [(tag::HOST_BLOCKS, false), (BACK, true)] {
                writer.blocks::<Error>(section, |sink| {
                    let mut words = vec![0; header.voxel_kind.block_words()];
                    for key in swapped.store.keys().filter(|key| superseded.contains(&key.pack()) == already_back) {
                        swapped.store.get(key, &mut words)?;
                        sink.block(key, &words)?;
                    }
                    Ok(())
                })?;
            }
            writer.blocks::<Error>(LEFT, |sink| {
                for left in self.mapper.left() {
                    for (key, words) in left.keys.iter().zip(left.words.chunks(header.voxel_kind.block_words())) {
                        sink.block(*key, words)?;
                    }
                }
                Ok(())
            })?;
        }
        match &mut self.atlas {
            None => writer.trajectory(&self.trajectory)?,
            Some(atlas) => {
                let submaps = atlas.settled(self.settings.map.fuse);
                let world_from = |submap: u16| submaps[usize::from(submap)].world_from_submap;
                writer.trajectory(&atlas.trajectory_with(world_from))?;
                writer.submaps(&submaps)?;
                let text = toml::to_string(&atlas.state(&self.trajectory)).map_err(|e| unfit(path, ATLAS, e))?;
                writer.bytes(ATLAS, text.as_bytes())?;
            }
        }
        let text = toml::to_string(&state).map_err(|e| unfit(path, STATE, e))?;
        writer.bytes(STATE, text.as_bytes())?;
        writer.bytes(COUNTERS, &to_bytes(on_device.counters))?;
        writer.bytes(FREE_BLOCKS, &to_bytes(on_device.free_blocks))?;
        writer.bytes(PENDING, &to_bytes(on_device.pending.into_iter().flatten()))?;
        writer.bytes(LAST_SEEN, &to_bytes(on_device.last_seen))?;
        if self.settings.map.track_changes {
            writer.bytes(CHANGED, &to_bytes(on_device.last_changed))?;
            let stored = self.mapper.swapped.iter().flat_map(|swapped| &swapped.changed);
            writer.bytes(HOST_CHANGED, &to_bytes(stored.flat_map(|([a, b], frame)| [*a, *b, *frame])))?;
            let left = self.mapper.left().flat_map(|left| {
                let known = left.changed.iter().copied().chain(std::iter::repeat(0));
                known.take(left.keys.len())
            });
            writer.bytes(LEFT_CHANGED, &to_bytes(left))?;
        }
        if let Some(places) = &self.places {
            writer.bytes(KEYFRAMES, &places.relocaliser.save())?;
        }
        for (place, local) in self.locals().enumerate() {
            let [model, lists @ ..] = sections_of(place);
            writer.bytes(model, &local.model.image.read_bytes(&self.device)?)?;
            for (tag, list) in lists.into_iter().zip(&local.lists) {
                if let Some(list) = list {
                    writer.bytes(tag, &list.read_bytes(&self.device)?)?;
                }
            }
        }
        Ok(writer.finish()?)
    }

    /// Goes on from a saved session, with its settings and its calibration. The device's adapter may be another one; the
    /// same bits come out on the same adapter only.
    ///
    /// # Errors
    /// Where the file cannot be read or holds no session, what it says of the submaps cannot be, or the device has no room for
    /// it. What is no use but not needed either is left out: see [`Slam::next_warning`].
    pub fn resume(device: &Device, path: &Path) -> Result<Self, Error> {
        let mut reader = MapReader::open(path)?;
        let mut state = read_state(&mut reader, path)?;
        let settings = settings_of(reader.header(), path)?;
        let poses = if state.poses_given { Poses::Given } else { Poses::Tracked };
        let mut slam = Self::new(device, &reader.header().calibration.clone(), &settings, poses)?;
        let kind = reader.header().voxel_kind;
        slam.trajectory = reader.trajectory()?;
        if slam.atlas.is_some() {
            let (atlas, left_out) = read_atlas(&mut reader, path, &settings.submaps, false)?;
            let (atlas, live) = Atlas::from_state(&settings.submaps, atlas);
            (slam.atlas, slam.trajectory) = (Some(atlas), live);
            slam.tell_left_out(path, ATLAS, left_out);
        }
        let submaps = slam.submaps().len().max(1);
        let known = |submap: u16| usize::from(submap) < submaps;
        if !known(state.primary.submap) {
            let reason = format!("frames are fused into submap {}, which is not there", state.primary.submap);
            return Err(unfit(path, STATE, reason));
        }
        state.primary.check().map_err(|reason| unfit(path, STATE, reason))?;

        let mut keys = Vec::new();
        reader.blocks::<Error>(tag::BLOCKS, |key, _| {
            keys.push(key.map_or(BlockKey::NO_KEY, BlockKey::pack));
            Ok(())
        })?;
        let last_changed = if reader.has(CHANGED) { to_words(&reader.bytes(CHANGED)?) } else { vec![0; keys.len()] };
        let on_device = MapState {
            capacity: state.mapper.capacity,
            counters: to_words(&reader.bytes(COUNTERS)?),
            free_blocks: to_words(&reader.bytes(FREE_BLOCKS)?),
            pending: pairs(&to_words(&reader.bytes(PENDING)?)),
            last_seen: to_words(&reader.bytes(LAST_SEEN)?),
            last_changed,
            keys,
        };
        slam.mapper.restore(&on_device)?;
        let mut written = 0;
        let mut some: Vec<(BlockKey, Vec<u32>)> = Vec::new();
        let nowhere = BlockKey::unpack(BlockKey::NO_KEY);
        let map = &slam.mapper.map;
        let mut write = |some: &mut Vec<(BlockKey, Vec<u32>)>| {
            let blocks: Vec<_> = some.iter().map(|(key, words)| HostBlock { key: *key, words }).collect();
            map.write_blocks(written, &blocks);
            written += blocks.len() as u32;
            some.clear();
        };
        reader.blocks::<Error>(tag::BLOCKS, |key, words| {
            some.push((key.unwrap_or(nowhere), words.to_vec()));
            if some.len() == 1024 {
                write(&mut some);
            }
            Ok(())
        })?;
        write(&mut some);
        if let Some(swapped) = &mut slam.mapper.swapped {
            for section in [tag::HOST_BLOCKS, BACK] {
                if !reader.has(section) {
                    continue;
                }
                reader.blocks::<Error>(section, |key, words| match key {
                    Some(key) => swapped.put(key, words),
                    None => Ok(()),
                })?;
            }
        }
        if let Some(swapped) = &mut slam.mapper.swapped
            && reader.has(HOST_CHANGED)
        {
            for stored in to_words(&reader.bytes(HOST_CHANGED)?).chunks_exact(3) {
                swapped.note_change(BlockKey::unpack([stored[0], stored[1]]), stored[2]);
            }
        }
        let mut left = Left::default();
        if reader.has(LEFT_CHANGED) {
            left.changed = to_words(&reader.bytes(LEFT_CHANGED)?);
        }
        if reader.has(LEFT) {
            reader.blocks::<Error>(LEFT, |key, words| {
                left.keys.extend(key);
                left.words.extend_from_slice(words);
                Ok(())
            })?;
        }
        if let (Some(surfels), Some(state)) = (&mut slam.mapper.surfels, &state.mapper.surfels) {
            let read = SurfelState {
                capacity: 0,
                counters: to_words(&reader.bytes(SURFEL_COUNTERS)?),
                free: to_words(&reader.bytes(FREE_SURFELS)?),
                slots: read_surfels(&mut reader, path)?,
            };
            surfels.set_state(state, read)?;
        }
        slam.mapper.set_state(&mut state.mapper, left, kind.block_words());
        let there = slam.mapper.submaps()?;
        if let Some(unknown) = there.iter().find(|submap| !known(**submap)) {
            return Err(Error::SavedState { path: path.to_path_buf(), reason: no_place(*unknown) });
        }
        // The place of each one's sections in the file.
        let mut places = vec![0];
        for ((beside, life), place) in state.beside.into_iter().zip(1..) {
            let submap = beside.submap;
            let twice = slam.locals().skip(1).any(|local| local.submap == submap) || submap == state.primary.submap;
            let checked = match () {
                () if !known(submap) => Err("it is not there".into()),
                () if twice => Err("it is tracked in already".into()),
                () => beside.check().and_then(|()| life.check(submap, submaps)),
            };
            if let Err(reason) = checked {
                slam.tell_left_out(path, STATE, [LeftOut { what: format!("tracking in submap {submap} is"), reason }]);
                continue;
            }
            let mut local = slam.new_local(submap)?;
            local.set_state(beside);
            slam.beside.push(Beside { local, life });
            places.push(place);
        }
        let active: Vec<u16> =
            slam.beside.iter().filter(|beside| beside.life.is_settled()).map(|beside| beside.local.submap).collect();
        let (primary, tracked) = (state.primary.submap, state.primary.is_tracked());
        let roles = slam.atlas.as_mut().map(|atlas| atlas.set_roles(primary, tracked, &active));
        slam.tell_left_out(path, ATLAS, roles.into_iter().flatten());
        if submaps > 1 && !there.contains(&primary) {
            // There is nothing to go on in: the camera is to be found in another one.
            state.primary.forget();
        }
        slam.primary.set_state(state.primary);
        for (place, local) in places.into_iter().zip(slam.locals()) {
            let [model, lists @ ..] = sections_of(place);
            local.model.image.write_bytes(device, &reader.bytes(model)?)?;
            for (tag, list) in lists.into_iter().zip(&local.lists) {
                if let Some(list) = list {
                    list.write_bytes(device, &reader.bytes(tag)?)?;
                }
            }
        }
        if let Some(error) = slam.load_keyframes(&mut reader, path)? {
            slam.leave_out_keyframes(path, &error);
        }
        slam.leave_out_without_blocks(None)?;
        slam.next_frame = state.next_frame;
        slam.next_look = state.next_look;
        Ok(slam)
    }

    /// Tracking in the primary submap, then in those beside it.
    fn locals(&self) -> impl Iterator<Item = &Local> {
        std::iter::once(&self.primary).chain(self.beside.iter().map(|beside| &beside.local))
    }

    /// Takes in a map's keyframes, where it has any and the settings ask for a relocaliser. What is wrong with them, where
    /// that cannot be done.
    fn load_keyframes(&mut self, reader: &mut MapReader, path: &Path) -> Result<Option<itm_reloc::Error>, Error> {
        let submaps = self.submaps().len().max(1);
        let Some(places) = self.places.as_mut().filter(|_| reader.has(KEYFRAMES)) else { return Ok(None) };
        if let Err(error) = places.relocaliser.load(&reader.bytes(KEYFRAMES)?) {
            return Ok(Some(error));
        }
        let of_submaps: BTreeSet<u16> = places.relocaliser.keyframes().iter().map(|keyframe| keyframe.submap).collect();
        let unknown = of_submaps.into_iter().filter(|submap| usize::from(*submap) >= submaps);
        let remove = |submap| LeftOut {
            what: format!("{} keyframes of submap {submap} are", places.relocaliser.remove_submap(submap)),
            reason: "it is not there".into(),
        };
        let left_out: Vec<_> = unknown.map(remove).collect();
        self.tell_left_out(path, KEYFRAMES, left_out);
        Ok(None)
    }

    fn leave_out_keyframes(&mut self, path: &Path, error: &itm_reloc::Error) {
        let reason = format!("{error}; a lost camera is found again only where this session has been");
        self.tell_left_out(path, KEYFRAMES, [LeftOut { what: "the keyframes are".into(), reason }]);
    }

    fn tell_left_out(&mut self, path: &Path, section: Tag, left_out: impl IntoIterator<Item = LeftOut>) {
        let section = section.escape_ascii().to_string();
        for LeftOut { what, reason } in left_out {
            self.warn(Warning::LeftOut { path: path.to_path_buf(), section: section.clone(), what, reason });
        }
    }

    /// Starts a new session in a saved map: at a pose in it, or, without one, wherever the relocaliser finds the first frames.
    /// Its voxels' size and kind are the map's, to which the settings must agree.
    ///
    /// # Errors
    /// Where the file cannot be read or holds no blocks, the settings disagree with it, what it says of the submaps cannot be, or
    /// the device has no room for it; without a pose also where the map has no keyframes, or they were made with other
    /// settings. With one such keyframes are left out, as is all that is no use but not needed either: see
    /// [`Slam::next_warning`].
    pub fn in_map(
        device: &Device,
        calibration: &itm_core::Calibration,
        settings: &Settings,
        path: &Path,
        world_from_camera: Option<&Se3>,
    ) -> Result<Self, Error> {
        let mut reader = MapReader::open(path)?;
        let mut slam = Self::new(device, calibration, settings, Poses::Tracked)?;
        let (layout, header) = (*slam.mapper.map.layout(), reader.header());
        let frames = header.counts.frames;
        let differs = |what, map: String, settings: String| {
            if map == settings {
                return Ok(());
            }
            Err(Error::OtherMap { path: path.to_path_buf(), what, map, settings })
        };
        let of_map = if reader.has(SURFELS) { "surfels" } else { "voxels" };
        let of_settings = if slam.mapper.surfels.is_some() { "surfels" } else { "voxels" };
        differs("a map of", of_map.to_owned(), of_settings.to_owned())?;
        if slam.mapper.surfels.is_none() {
            differs("map.voxel_size_m", header.voxel_size_m.to_string(), layout.voxel_size_m.to_string())?;
            differs("map.truncation_m", header.truncation_m.to_string(), layout.truncation_m.to_string())?;
            differs("voxels", format!("{:?}", header.voxel_kind), format!("{:?}", layout.kind))?;
        }
        // What the map shows was observed as often as its weights say.
        slam.primary.age.frames = frames;
        let poses = reader.submaps()?;
        if slam.atlas.is_none() {
            let map = match &poses[..] {
                [] => None,
                [one] if one.submap == 0 && one.world_from_submap == Se3::IDENTITY => None,
                [_] => Some("one that is not the world's own".to_owned()),
                more => Some(more.len().to_string()),
            };
            if let Some(map) = map {
                let settings = if settings.mode.has_submaps() {
                    "that poses come from files, which are those of one map".to_owned()
                } else {
                    format!("mode = {:?}", slam.settings.mode.name())
                };
                differs("submaps:", map, settings)?;
            }
        } else if reader.has(ATLAS) {
            let (state, left_out) = read_atlas(&mut reader, path, &settings.submaps, true)?;
            slam.atlas = Some(Atlas::from_state(&settings.submaps, state).0.afresh());
            slam.tell_left_out(path, ATLAS, left_out);
        } else if !poses.is_empty() {
            let atlas = Atlas::of_poses(&settings.submaps, &poses);
            slam.atlas = Some(atlas.map_err(|reason| unfit(path, tag::SUBMAPS, reason))?);
        }
        let submaps = slam.submaps().len().max(1);
        if settings.map.index == MapIndex::Dense {
            (1..submaps as u16).try_for_each(|submap| slam.mapper.begin_submap(submap))?;
        }
        for section in [tag::BLOCKS, tag::HOST_BLOCKS, LEFT] {
            let outside = if reader.has(section) { slam.mapper.take_in(&mut reader, section)? } else { 0 };
            if outside > 0 {
                let reason = "they lie outside of map.dense".into();
                slam.tell_left_out(path, section, [LeftOut { what: format!("{outside} blocks are"), reason }]);
            }
        }
        if let Some(surfels) = &mut slam.mapper.surfels {
            surfels.take_in(&read_surfels(&mut reader, path)?)?;
            if surfels.is_empty() {
                return Err(Error::EmptyMap { path: path.to_path_buf() });
            }
        }
        let there = slam.mapper.submaps()?;
        if there.is_empty() && slam.mapper.surfels.is_none() {
            return Err(Error::EmptyMap { path: path.to_path_buf() });
        }
        if let Some(unknown) = there.iter().find(|submap| usize::from(**submap) >= submaps) {
            return Err(Error::SavedState { path: path.to_path_buf(), reason: no_place(*unknown) });
        }
        if let Some(atlas) = &mut slam.atlas {
            for submap in (0..submaps as u16).filter(|submap| there.contains(submap)) {
                if !atlas.has_central(submap) {
                    atlas.set_central(submap, &slam.mapper.all_block_centres(submap)?);
                }
            }
        }
        let unusable = slam.load_keyframes(&mut reader, path)?;
        slam.leave_out_without_blocks(None)?;
        match (unusable, world_from_camera) {
            (None, None) => {
                if slam.places.as_ref().is_none_or(|places| places.relocaliser.keyframes().is_empty()) {
                    return Err(Error::NoKeyframes { path: path.to_path_buf() });
                }
            }
            (None, Some(pose)) => slam.start_in_world(pose)?,
            (Some(error), Some(pose)) => {
                slam.leave_out_keyframes(path, &error);
                slam.start_in_world(pose)?;
            }
            (Some(reason), None) => return Err(Error::UnusableKeyframes { path: path.to_path_buf(), reason }),
        }
        Ok(slam)
    }
}
