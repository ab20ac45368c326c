//! Trackers chosen by one string, `type=extended,levels=rrbb,useDepth=1`, as in the reference system (the report, section
//! 3.1.4).

use super::{CompositePolicy, CompositeSettings, SettingsError, TrackerKind, TrackerSettings};

/// A key of a tracker's string and what it sets.
struct Key {
    name: &'static str,
    expected: &'static str,
    set: fn(&mut TrackerSettings, &str) -> Option<()>,
}

const LEVELS: &str = "one to eight of the letters r, t, b, n";
const SWITCH: &str = "0 or 1";
const NUMBER: &str = "a number";
const COUNT: &str = "a whole number";

fn parse<T: std::str::FromStr>(text: &str) -> Option<T> {
    text.parse().ok()
}

fn switch(text: &str) -> Option<bool> {
    match text {
        "0" | "false" => Some(false),
        "1" | "true" => Some(true),
        _ => None,
    }
}

/// From a squared distance in m² to a distance in m.
fn root(text: &str) -> Option<f32> {
    parse::<f32>(text).filter(|v| *v >= 0.0).map(f32::sqrt)
}

/// A key that sets a field to the value that a function reads from the text.
macro_rules! key {
    ($name:literal, $expected:expr, $($field:ident).+, $read:expr) => {
        Key {
            name: $name,
            expected: $expected,
            set: |settings, text| {
                settings.$($field).+ = $read(text)?;
                Some(())
            },
        }
    };
}

fn text(value: &str) -> Option<String> {
    Some(value.into())
}

const ICP: [Key; 7] = [
    key!("levels", LEVELS, icp.levels, text),
    key!("minstep", NUMBER, icp.min_step, parse),
    key!("outlierC", "a squared distance in square metres", icp.max_distance_coarse_m, root),
    key!("outlierF", "a squared distance in square metres", icp.max_distance_fine_m, root),
    key!("numiterC", COUNT, icp.max_steps_coarse, parse),
    key!("numiterF", COUNT, icp.max_steps_fine, parse),
    key!("failureDec", NUMBER, icp.max_rms_mm, parse),
];

const EXTENDED: [Key; 16] = [
    key!("levels", LEVELS, extended.levels, text),
    key!("useDepth", SWITCH, extended.use_depth, switch),
    key!("useColour", SWITCH, extended.use_colour, switch),
    key!("colourWeight", NUMBER, extended.colour_weight, parse),
    key!("minstep", NUMBER, extended.min_step, parse),
    key!("outlierSpaceC", "a distance in metres", extended.max_plane_distance_coarse_m, parse),
    key!("outlierSpaceF", "a distance in metres", extended.max_plane_distance_fine_m, parse),
    key!("outlierColourC", "a difference in intensity", extended.max_colour_difference_coarse, parse),
    key!("outlierColourF", "a difference in intensity", extended.max_colour_difference_fine, parse),
    key!("minColourGradient", NUMBER, extended.min_colour_gradient, parse),
    key!("numiterC", COUNT, extended.max_steps_coarse, parse),
    key!("numiterF", COUNT, extended.max_steps_fine, parse),
    key!("tukeyCutOff", NUMBER, extended.tukey_cutoff, parse),
    key!("framesToSkip", COUNT, extended.frames_to_skip, parse),
    key!("framesToWeight", COUNT, extended.frames_to_weight, parse),
    key!("failureDec", NUMBER, extended.max_rms_mm, parse),
];

const RGB: [Key; 1] = [key!("levels", LEVELS, rgb.levels, text)];
const IMU_ICP: [Key; 1] = [key!("levels", LEVELS, imu.icp_levels, text)];
const EXTENDED_IMU: [Key; 1] = [key!("levels", LEVELS, imu.extended_levels, text)];
const FILE: [Key; 1] = [key!("mask", "a file name with the frame's number", file.mask, text)];
const COMPOSITE: [Key; 1] =
    [key!("policy", "refine, sequential or first-success", composite.policy, CompositePolicy::from_name)];

/// The keys of a kind: its own, then those of the tracker that it refines with.
fn keys(kind: TrackerKind) -> (&'static [Key], &'static [Key]) {
    match kind {
        TrackerKind::Icp => (&ICP, &[]),
        TrackerKind::Extended => (&EXTENDED, &[]),
        TrackerKind::Rgb => (&RGB, &[]),
        TrackerKind::ImuIcp => (&IMU_ICP, &ICP),
        TrackerKind::ExtendedImu => (&EXTENDED_IMU, &EXTENDED),
        TrackerKind::File => (&FILE, &[]),
        TrackerKind::ForceFail => (&[], &[]),
        TrackerKind::Composite => (&COMPOSITE, &[]),
    }
}

impl CompositePolicy {
    /// Every policy.
    pub const ALL: [Self; 3] = [Self::Refine, Self::Sequential, Self::FirstSuccess];

    /// Its name in settings.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Refine => "refine",
            Self::Sequential => "sequential",
            Self::FirstSuccess => "first-success",
        }
    }

    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|policy| policy.name() == name)
    }
}

impl TrackerSettings {
    /// Chooses a tracker by a string of `key=value` pairs, separated by commas, of which the first is `type=…`; what the
    /// string does not name stays as it is.
    ///
    /// Keys and their meaning are the reference system's: for `icp` levels, minstep, outlierC and outlierF (squared
    /// distances), numiterC, numiterF, failureDec; for `extended` also useDepth, useColour, colourWeight, outlierSpaceC,
    /// outlierSpaceF, outlierColourC, outlierColourF, minColourGradient, tukeyCutOff, framesToSkip, framesToWeight; for `rgb`
    /// levels; for `imuicp` and `extendedimu` levels and the keys of the tracker that they refine with; for `file` mask;
    /// for `composite` policy, its trackers following after semicolons: `type=composite,policy=refine;type=icp;type=rgb`.
    /// failureDec is the largest root mean square residual, in millimetres, of a frame that counts as tracked.
    ///
    /// # Errors
    /// A kind or a key that is not known, with the valid ones, and a value that cannot be meant. The settings are as they
    /// were then.
    pub fn set_string(&mut self, given: &str) -> Result<(), SettingsError> {
        let error = |message: String| SettingsError::TrackerString { given: given.into(), message };
        let mut parts = given.split(';').map(str::trim);
        let own = parts.next().unwrap_or_default();
        let mut pairs = Vec::new();
        for pair in own.split(',').map(str::trim).filter(|p| !p.is_empty()) {
            let (key, value) =
                pair.split_once('=').ok_or_else(|| error(format!("'{pair}' is not of the form key=value")))?;
            pairs.push((key.trim(), value.trim()));
        }
        let kinds = TrackerKind::ALL.map(TrackerKind::name).join(", ");
        let types: Vec<&str> = pairs.iter().filter(|(key, _)| *key == "type").map(|(_, value)| *value).collect();
        let [name] = types[..] else {
            return Err(error(format!("a tracker's string names its type once: type={}", kinds.replace(", ", "|"))));
        };
        let kind = TrackerKind::ALL
            .into_iter()
            .find(|kind| kind.name() == name)
            .ok_or_else(|| error(format!("there is no tracker '{name}'; there are {kinds}")))?;
        let mut settings = Self { kind, ..self.clone() };
        let (own_keys, further_keys) = keys(kind);
        for (key, value) in pairs.into_iter().filter(|(key, _)| *key != "type") {
            let Some(found) = own_keys.iter().chain(further_keys).find(|k| k.name == key) else {
                let mut valid: Vec<&str> = own_keys.iter().map(|k| k.name).collect();
                valid.extend(
                    further_keys.iter().map(|k| k.name).filter(|name| !own_keys.iter().any(|k| k.name == *name)),
                );
                return Err(error(match &valid[..] {
                    [] => format!("'{name}' has no keys, so '{key}' cannot be set"),
                    valid => format!("'{name}' has no key '{key}'; its keys are {}", valid.join(", ")),
                }));
            };
            (found.set)(&mut settings, value)
                .ok_or_else(|| error(format!("{key} must be {}, not '{value}'", found.expected)))?;
        }
        let trackers: Vec<String> = parts.filter(|p| !p.is_empty()).map(String::from).collect();
        if !trackers.is_empty() {
            if kind != TrackerKind::Composite {
                return Err(error(format!(
                    "'{name}' has no trackers of its own; those of a composite follow after ';'"
                )));
            }
            settings.composite.trackers = trackers;
        }
        settings.validate()?;
        *self = settings;
        Ok(())
    }

    /// The settings of a composite's trackers, in order.
    ///
    /// # Errors
    /// A string that cannot be used, or names a composite.
    pub fn parts(&self) -> Result<Vec<Self>, SettingsError> {
        let part = |given: &String| {
            let mut settings = Self { kind: TrackerKind::Icp, ..self.clone() };
            settings.composite = CompositeSettings::default();
            settings.set_string(given)?;
            if settings.kind == TrackerKind::Composite {
                let message = "a composite cannot be part of one".into();
                return Err(SettingsError::TrackerString { given: given.clone(), message });
            }
            Ok(settings)
        };
        self.composite.trackers.iter().map(part).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    fn set(given: &str) -> Result<TrackerSettings, String> {
        let mut settings = TrackerSettings::default();
        settings.set_string(given).map(|()| settings).map_err(|e| e.to_string())
    }

    #[test]
    fn the_references_strings_are_understood() {
        let icp =
            set("type=icp,levels=rrrbb,minstep=1e-3,outlierC=0.01,outlierF=0.0025,numiterC=10,numiterF=2,failureDec=5")
                .unwrap();
        assert_eq!(icp.kind, TrackerKind::Icp);
        assert_eq!((icp.icp.max_distance_coarse_m, icp.icp.max_distance_fine_m), (0.1, 0.05));
        assert_eq!((icp.icp.max_steps_coarse, icp.icp.max_steps_fine, icp.icp.min_step), (10, 2, 1e-3));
        assert_eq!(icp.icp.max_rms_mm, 5.0);
        let extended = set(
            "type=extended,levels=rrbb,useDepth=1,useColour=1,colourWeight=0.3,minstep=1e-4,outlierSpaceC=0.1,\
             outlierSpaceF=0.004,outlierColourC=0.175,outlierColourF=0.005,minColourGradient=0.01,numiterC=20,numiterF=50,\
             tukeyCutOff=8,framesToSkip=20,framesToWeight=50,failureDec=20",
        )
        .unwrap()
        .extended;
        assert!(extended.use_depth && extended.use_colour);
        assert_eq!((extended.levels.as_str(), extended.tukey_cutoff, extended.frames_to_weight), ("rrbb", 8.0, 50));
        assert_eq!(set("type=rgb,levels=rrbb").unwrap().kind, TrackerKind::Rgb);
        let imu = set("type=imuicp,levels=tb,numiterC=7").unwrap();
        assert_eq!((imu.imu.icp_levels.as_str(), imu.icp.max_steps_coarse), ("tb", 7));
        assert_eq!(set("type=extendedimu,levels=ttb").unwrap().imu.extended_levels, "ttb");
        assert_eq!(set("type=file,mask=poses/%06d.txt").unwrap().file.mask, "poses/%06d.txt");
        assert_eq!(set("type=forcefail").unwrap().kind, TrackerKind::ForceFail);
        let composite = set("type=composite,policy=first-success;type=icp,levels=rb; type=rgb").unwrap();
        let parts = composite.parts().unwrap();
        assert_eq!(parts.iter().map(|p| p.kind).collect::<Vec<_>>(), [TrackerKind::Icp, TrackerKind::Rgb]);
        assert_eq!(parts[0].icp.levels, "rb");
    }

    #[test]
    fn what_is_not_understood_is_named_with_what_would_be() {
        for (given, says) in [
            ("levels=rrbb", "type=icp|extended|rgb"),
            ("type=icp,type=rgb", "once"),
            ("type=orb", "there is no tracker 'orb'; there are icp, extended"),
            ("type=icp,useDepth=1", "'icp' has no key 'useDepth'; its keys are levels, minstep"),
            ("type=extended,levels", "'levels' is not of the form"),
            ("type=extended,useDepth=yes", "useDepth must be 0 or 1, not 'yes'"),
            ("type=extended,numiterC=-1", "numiterC must be a whole number, not '-1'"),
            ("type=icp,outlierC=-1", "outlierC must be a squared distance"),
            ("type=icp,levels=xyz", "tracker.icp.levels must be"),
            ("type=forcefail,levels=rb", "'forcefail' has no keys"),
            ("type=icp;type=rgb", "no trackers of its own"),
            ("type=composite;type=composite", "cannot be part of one"),
            ("type=composite;type=icp,x=1", "no key 'x'"),
            ("type=composite,policy=all;type=icp", "policy must be refine, sequential or first-success"),
        ] {
            let error = set(given).unwrap_err();
            assert!(error.contains(says), "{given}: {error}");
        }
    }

    #[test]
    fn a_string_may_take_the_place_of_the_tree() {
        let settings = Settings::resolve(
            Some(("s.toml", "tracker = \"type=icp,levels=rb\"\n")),
            &["tracker.icp.max_steps_fine=9".into()],
        )
        .unwrap();
        assert_eq!(settings.tracker.kind, TrackerKind::Icp);
        assert_eq!((settings.tracker.icp.levels.as_str(), settings.tracker.icp.max_steps_fine), ("rb", 9));
        let settings =
            Settings::resolve(None, &["tracker.rgb.levels=bb".into(), "tracker=type=extended,levels=bb".into()])
                .unwrap();
        assert_eq!((settings.tracker.rgb.levels.as_str(), settings.tracker.extended.levels.as_str()), ("bb", "bb"));
        let error = Settings::resolve(Some(("s.toml", "tracker = \"type=icp,x=1\"\n")), &[]).unwrap_err().to_string();
        assert!(error.contains("s.toml") && error.contains("no key 'x'"), "{error}");
    }
}
