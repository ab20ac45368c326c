//! What a user can do: the keys, the buttons and the shortcut sheet all come from one list.

use egui::{Key, KeyboardShortcut, Modifiers};

/// Something that a user can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Action {
    Open,
    RunOrPause,
    Run,
    Step,
    Fusion,
    Reset,
    View,
    Colouring,
    PreviousSubmap,
    NextSubmap,
    ShowAll,
    Save,
    Load,
    Mesh,
    RecordFrames,
    RecordVideo,
    Settings,
    Sidebar,
    Shortcuts,
    Theme,
    Quit,
}

/// What is known of an action: its button, what it says of itself, and its keys.
pub(crate) struct About {
    pub(crate) action: Action,
    /// What the button shows.
    pub(crate) label: &'static str,
    /// What it does, in a sentence.
    pub(crate) does: &'static str,
    pub(crate) keys: &'static [KeyboardShortcut],
}

const fn key(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::NONE, key)
}

const fn command(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::COMMAND, key)
}

/// All actions, in the order of the shortcut sheet. Single letters are those that users of InfiniTAM know.
pub(crate) const ACTIONS: &[About] = &[
    About {
        action: Action::Open,
        label: "Open…",
        does: "Open a recording, a map or the results of a run",
        keys: &[key(Key::O), command(Key::O)],
    },
    About {
        action: Action::RunOrPause,
        label: "▶ Run",
        does: "Process frames one after the other, or pause",
        keys: &[key(Key::Space)],
    },
    About { action: Action::Run, label: "Run on", does: "Process frames one after the other", keys: &[key(Key::B)] },
    About { action: Action::Step, label: "⏭ Step", does: "Process one frame, then pause", keys: &[key(Key::N)] },
    About {
        action: Action::Fusion,
        label: "Fusion",
        does: "Fuse frames into the map, or only track the camera in it",
        keys: &[key(Key::T)],
    },
    About {
        action: Action::Reset,
        label: "⟲ Reset",
        does: "Start the recording again with an empty map and the settings as they are now",
        keys: &[key(Key::R)],
    },
    About {
        action: Action::View,
        label: "Free view",
        does: "Look from anywhere, or follow the recording's camera",
        keys: &[key(Key::F)],
    },
    About {
        action: Action::Colouring,
        label: "Colouring",
        does: "Show the map in the next way: shaded, grey, colours, normals, depth, confidence",
        keys: &[key(Key::C)],
    },
    About {
        action: Action::PreviousSubmap,
        label: "⏴",
        does: "Show the submap before this one alone, or all of them",
        keys: &[key(Key::OpenBracket)],
    },
    About {
        action: Action::NextSubmap,
        label: "⏵",
        does: "Show the submap after this one alone, or all of them",
        keys: &[key(Key::CloseBracket)],
    },
    About {
        action: Action::ShowAll,
        label: "⛶ All",
        does: "Place the free view so that everything is in it",
        keys: &[key(Key::Home)],
    },
    About {
        action: Action::Save, label: "Save…", does: "Save the map, to go on with it later", keys: &[key(Key::K)]
    },
    About {
        action: Action::Load,
        label: "Load…",
        does: "Load a saved map: to look at, or to track this recording in",
        keys: &[key(Key::L)],
    },
    About {
        action: Action::Mesh,
        label: "Mesh…",
        does: "Write the map's surface to a file: .ply, .glb, .obj or .stl",
        keys: &[key(Key::W)],
    },
    About {
        action: Action::RecordFrames,
        label: "Frames…",
        does: "Record what the large pane shows as a folder of pictures, or end that",
        keys: &[key(Key::S)],
    },
    About {
        action: Action::RecordVideo,
        label: "Video…",
        does: "Record what the large pane shows as a video, or end that",
        keys: &[key(Key::V)],
    },
    About {
        action: Action::Settings,
        label: "⚙ Settings",
        does: "Show all settings, or hide them",
        keys: &[key(Key::Comma)],
    },
    About {
        action: Action::Sidebar,
        label: "Panes",
        does: "Show depth, colour, plots and messages, or hide them",
        keys: &[key(Key::I)],
    },
    About { action: Action::Theme, label: "🌓", does: "Light or dark", keys: &[command(Key::D)] },
    About {
        action: Action::Shortcuts,
        label: "?",
        does: "Show this list, or hide it",
        keys: &[key(Key::F1), key(Key::Questionmark), KeyboardShortcut::new(Modifiers::SHIFT, Key::Slash)],
    },
    About {
        action: Action::Quit,
        label: "Quit",
        does: "Close the window; what was reconstructed so far is kept",
        keys: &[key(Key::E), key(Key::Escape), command(Key::Q)],
    },
];

/// What the mouse and the keys do in the free view, for the shortcut sheet.
pub(crate) const VIEW_HELP: &[(&str, &str)] = &[
    ("Drag", "turn around the pivot"),
    ("Shift + drag, or right button", "move across"),
    ("Ctrl + drag", "turn on the spot"),
    ("Wheel, middle button, or pinch", "come nearer, or go away"),
    ("Double-click", "turn around this point from now on"),
    ("Arrow keys", "turn around the pivot"),
    ("Shift + arrow keys", "fly ahead and back, left and right"),
    ("Page up, page down", "fly up and down"),
    ("+, −", "come nearer, or go away"),
];

impl Action {
    pub(crate) fn about(self) -> &'static About {
        ACTIONS.iter().find(|about| about.action == self).expect("every action is in the list")
    }
}

impl About {
    /// What it does and its keys: a button's tooltip.
    pub(crate) fn tooltip(&self) -> String {
        format!("{} ({})", self.does, self.shown_keys())
    }

    /// Its keys as they are written.
    pub(crate) fn shown_keys(&self) -> String {
        let is_mac = cfg!(target_os = "macos");
        let names: Vec<String> = self
            .keys
            .iter()
            .filter(|keys| keys.modifiers != Modifiers::SHIFT)
            .map(|keys| {
                let command = if is_mac { "⌘" } else { "Ctrl+" };
                let before = if keys.modifiers.command { command } else { "" };
                let name = keys.logical_key.symbol_or_name();
                format!("{before}{}", if keys.logical_key == Key::Escape { "Esc" } else { name })
            })
            .collect();
        names.join(" or ")
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn every_action_has_keys_of_its_own() {
        let keys: Vec<_> = ACTIONS.iter().flat_map(|about| about.keys).collect();
        let different: HashSet<_> = keys.iter().map(|keys| format!("{keys:?}")).collect();
        assert_eq!(different.len(), keys.len());
        assert!(ACTIONS.iter().all(|about| !about.keys.is_empty()));
    }

    #[test]
    fn the_keys_are_those_that_users_of_infinitam_know() {
        let of = |letter: Key| ACTIONS.iter().find(|a| a.keys.contains(&key(letter))).map(|a| a.action);
        let known = [
            (Key::N, Action::Step),
            (Key::B, Action::Run),
            (Key::S, Action::RecordFrames),
            (Key::V, Action::RecordVideo),
            (Key::E, Action::Quit),
            (Key::Escape, Action::Quit),
            (Key::F, Action::View),
            (Key::C, Action::Colouring),
            (Key::T, Action::Fusion),
            (Key::W, Action::Mesh),
            (Key::R, Action::Reset),
            (Key::K, Action::Save),
            (Key::L, Action::Load),
            (Key::OpenBracket, Action::PreviousSubmap),
            (Key::CloseBracket, Action::NextSubmap),
        ];
        for (letter, action) in known {
            assert_eq!(of(letter), Some(action), "{letter:?}");
        }
    }
}
