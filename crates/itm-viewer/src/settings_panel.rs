//! The settings as a form, made of their schema, so that every setting has its widget and its documentation.

mod form;
#[cfg(test)]
mod tests;
mod widgets;

use std::collections::BTreeMap;

use egui::{Button, CollapsingHeader, Grid, Label, RichText, ScrollArea, TextEdit, Ui};
use itm_core::{Settings, SettingsError};
use serde::Deserialize as _;
use serde_json::Value;

use form::{Entry, Group, Leaf, NEEDS_RESTART, as_toml, difference, form, tree_of};

/// On the button that brings a default back; of the few signs that the interface's font has.
const RESET: &str = "×";

/// What the user wants done.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum SettingsAction {
    /// These valid settings are the ones to use. A running session takes over of them what it can.
    Changed(Settings),
    /// The recording is to be started again with these settings.
    Restart(Settings),
}

/// The settings as they are edited.
///
/// Edits that cannot be used stay, with what is wrong with them, until they are put right; the last settings that could be used
/// stand meanwhile.
#[derive(Debug)]
pub(crate) struct SettingsPanel {
    form: Group,
    defaults: Value,
    edited: Value,
    /// The last ones that could be used.
    settings: Settings,
    /// Those of the running session, as they were asked for.
    in_force: Option<Settings>,
    /// Keys that differ from those and need another session.
    waiting: Vec<String>,
    trouble: Option<Trouble>,
    /// What was written for a setting and is no value yet, by key.
    unread: BTreeMap<String, String>,
    search: String,
}

/// Why edited settings cannot be used.
#[derive(Debug)]
struct Trouble {
    /// The setting, where it is one.
    key: Option<String>,
    message: String,
}

impl SettingsPanel {
    /// A form that begins with settings.
    pub(crate) fn new(settings: Settings) -> Self {
        Self {
            form: form(),
            defaults: tree_of(&Settings::default()),
            edited: tree_of(&settings),
            settings,
            in_force: None,
            waiting: Vec::new(),
            trouble: None,
            unread: BTreeMap::new(),
            search: String::new(),
        }
    }

    /// The last settings that could be used.
    #[cfg(test)]
    fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Goes on with other settings, as those of a file, and forgets what was edited.
    pub(crate) fn set_settings(&mut self, settings: Settings) {
        self.edited = tree_of(&settings);
        self.settings = settings;
        self.trouble = None;
        self.unread.clear();
        self.compare();
    }

    /// Says which settings a session was begun with, as they were asked for (before they were fitted to a recording, by which
    /// some would seem to differ), or that none runs.
    pub(crate) fn set_in_force(&mut self, settings: Option<Settings>) {
        self.in_force = settings;
        self.compare();
    }

    /// Shows the form. What the user wants done, if anything.
    pub(crate) fn ui(&mut self, ui: &mut Ui) -> Option<SettingsAction> {
        let mut changed = self.head(ui);
        let restart = self.told(ui);
        let words: Vec<String> = self.search.split_whitespace().map(str::to_lowercase).collect();
        let mut drawing = Drawing {
            edited: &mut self.edited,
            unread: &mut self.unread,
            wrong: self.trouble.as_ref().and_then(|trouble| trouble.key.as_deref()),
            words: &words,
            changed: false,
        };
        ScrollArea::vertical().auto_shrink([false, true]).show(ui, |ui| {
            if !words.is_empty() && !self.form.matches(&words) {
                ui.weak("No setting has this in its name or documentation");
            }
            drawing.entries(ui, &self.form, words.is_empty());
        });
        changed |= drawing.changed;
        if changed {
            return self.take().map(SettingsAction::Changed);
        }
        restart.then(|| SettingsAction::Restart(self.settings.clone()))
    }

    /// What stands above the tree. Whether the settings were changed.
    fn head(&mut self, ui: &mut Ui) -> bool {
        let differing = difference(&self.edited, &self.defaults);
        let mut changed = false;
        ui.horizontal(|ui| {
            let label = ui.label("Search");
            ui.add(
                TextEdit::singleline(&mut self.search).desired_width(f32::INFINITY).hint_text("name or documentation"),
            )
            .labelled_by(label.id);
        });
        ui.horizontal(|ui| {
            let differs = !differing.is_empty() || !self.unread.is_empty();
            let defaults = ui.add_enabled(differs, Button::new("Defaults"));
            if defaults.on_hover_text("Every setting back to its default").clicked() {
                self.edited = self.defaults.clone();
                self.unread.clear();
                changed = true;
            }
            let copy = ui.add_enabled(!differing.is_empty(), Button::new("Copy as TOML"));
            let hint = "What differs from the defaults, as it stands in a settings file";
            if copy.on_hover_text(hint).on_disabled_hover_text("Every setting has its default").clicked()
                && let Ok(text) = toml::to_string(&differing)
            {
                ui.ctx().copy_text(text);
            }
        });
        changed
    }

    /// What is wrong, and what waits. Whether the recording is to be started again.
    fn told(&mut self, ui: &mut Ui) -> bool {
        if let Some(trouble) = &self.trouble {
            let message = RichText::new(&trouble.message).color(ui.visuals().error_fg_color);
            ui.add(Label::new(message).wrap());
        }
        let count = self.waiting.len();
        if count == 0 {
            return false;
        }
        let text = match count {
            1 => "1 setting waits for a restart".to_owned(),
            _ => format!("{count} settings wait for a restart"),
        };
        ui.horizontal_wrapped(|ui| {
            let told = ui.label(RichText::new(text).color(ui.visuals().warn_fg_color));
            told.on_hover_text(self.waiting.join("\n"));
            let restart = ui.add_enabled(self.trouble.is_none(), Button::new("Restart to apply"));
            restart.on_hover_text("Starts the recording again with these settings").clicked()
        })
        .inner
    }

    /// The edited settings, if they can be used and are others than before.
    fn take(&mut self) -> Option<Settings> {
        match self.read() {
            Ok(settings) => {
                self.trouble = None;
                let changed = settings != self.settings;
                self.settings = settings;
                self.compare();
                changed.then(|| self.settings.clone())
            }
            Err(trouble) => {
                self.trouble = Some(trouble);
                None
            }
        }
    }

    fn read(&self) -> Result<Settings, Trouble> {
        if let Some((key, text)) = self.unread.iter().next() {
            let message = format!("{key}: '{text}' is no value, as in a settings file");
            return Err(Trouble { key: Some(key.clone()), message });
        }
        let settings =
            Settings::deserialize(&self.edited).map_err(|e| Trouble { key: None, message: e.to_string() })?;
        settings.validate().map_err(|error| {
            let key = if let SettingsError::Value { key, .. } = error { Some(key.to_owned()) } else { None };
            Trouble { key, message: error.to_string() }
        })?;
        Ok(settings)
    }

    /// Compares the settings with those in force, of which a running session takes over what it can.
    fn compare(&mut self) {
        self.waiting = match &self.in_force {
            None => Vec::new(),
            Some(in_force) => match in_force.with_live(&self.settings) {
                Ok((now, waiting)) => {
                    self.in_force = Some(now);
                    waiting
                }
                // They can only be used all together.
                Err(_) => keys_of(&difference(&tree_of(&self.settings), &tree_of(in_force)).into(), ""),
            },
        };
    }
}

/// The full keys of a tree's values.
fn keys_of(tree: &Value, key: &str) -> Vec<String> {
    let Some(group) = tree.as_object() else { return vec![key.into()] };
    let name = |name: &String| if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
    group.iter().flat_map(|(of, tree)| keys_of(tree, &name(of))).collect()
}

/// The tree as it is drawn, and edited by that.
struct Drawing<'a> {
    edited: &'a mut Value,
    unread: &'a mut BTreeMap<String, String>,
    /// The setting that cannot be used.
    wrong: Option<&'a str>,
    /// What is looked for.
    words: &'a [String],
    changed: bool,
}

impl Drawing<'_> {
    /// A group's entries: all of them, or what matches.
    fn entries(&mut self, ui: &mut Ui, group: &Group, all: bool) {
        let mut entries = &group.entries[..];
        while let Some(first) = entries.first() {
            if let Entry::Group(within) = first {
                entries = &entries[1..];
                if all || within.matches(self.words) {
                    self.group(ui, within, all);
                }
                continue;
            }
            // Rows that follow each other are one grid.
            let rows = entries.iter().take_while(|entry| matches!(entry, Entry::Leaf(_))).count();
            let (leaves, others) = entries.split_at(rows);
            entries = others;
            Grid::new((&group.key, others.len())).num_columns(3).striped(true).show(ui, |ui| {
                for entry in leaves {
                    if let Entry::Leaf(leaf) = entry
                        && (all || leaf.matches(self.words))
                    {
                        self.leaf(ui, leaf);
                        ui.end_row();
                    }
                }
            });
        }
    }

    fn group(&mut self, ui: &mut Ui, group: &Group, all: bool) {
        let searching = !self.words.is_empty();
        let of_group = self.wrong.is_some_and(|key| key.strip_prefix(&group.key).is_some_and(|k| k.starts_with('.')));
        let mut title = RichText::new(&group.name);
        if of_group {
            title = title.color(ui.visuals().error_fg_color);
        }
        // While something is looked for groups are others, so that afterwards those are open that were.
        CollapsingHeader::new(title)
            .id_salt((&group.key, searching))
            .open(searching.then_some(true))
            .show(ui, |ui| self.entries(ui, group, all || group.matches_itself(self.words)))
            .header_response
            .on_hover_text(&group.documentation);
    }

    /// A row: name and marks, widget, and the way back to the default.
    fn leaf(&mut self, ui: &mut Ui, leaf: &Leaf) {
        let Some(value) = self.edited.pointer_mut(&leaf.pointer) else { return };
        let differs = *value != leaf.default || self.unread.contains_key(&leaf.key);
        let label = ui
            .horizontal(|ui| {
                let mut name = RichText::new(&leaf.name);
                if differs {
                    name = name.strong();
                }
                if self.wrong == Some(leaf.key.as_str()) {
                    name = name.color(ui.visuals().error_fg_color);
                }
                let label = ui.label(name).on_hover_ui(|ui| widgets::tooltip(ui, &leaf.tooltip()));
                if !leaf.is_live {
                    widgets::restart_mark(ui).on_hover_text(NEEDS_RESTART).accessible_name(NEEDS_RESTART);
                }
                label
            })
            .inner;
        let tooltip = || leaf.tooltip();
        let row = widgets::Row { key: &leaf.key, label: label.id, tooltip: &tooltip };
        self.changed |= ui.horizontal(|ui| row.show(ui, &leaf.kind, value, self.unread)).inner;
        if differs {
            let reset = ui.small_button(RESET).accessible_name(format!("Reset {}", leaf.name));
            if reset.on_hover_text(format!("Back to the default: {}", as_toml(&leaf.default))).clicked() {
                *value = leaf.default.clone();
                self.unread.remove(&leaf.key);
                self.changed = true;
            }
        }
    }
}
