//! A widget for each kind of setting.

use std::collections::BTreeMap;
use std::f32::consts::FRAC_PI_2;

use egui::{ComboBox, DragValue, Id, Response, Sense, Shape, Stroke, TextEdit, TextStyle, Ui, Vec2};
use serde_json::Value;

use super::form::{Choice, Kind, Number, as_toml};

/// Width of what text is written in.
const TEXT_WIDTH: f32 = 150.0;

/// A setting's row.
pub(super) struct Row<'a> {
    pub(super) key: &'a str,
    /// What says its name.
    pub(super) label: Id,
    pub(super) tooltip: &'a dyn Fn() -> String,
}

/// A tooltip's text, which is only made where it is shown.
pub(super) fn tooltip(ui: &mut Ui, text: &str) {
    ui.set_max_width(ui.spacing().tooltip_width);
    ui.label(text);
}

/// An arrow that goes round, drawn because the interface's font has none.
pub(super) fn restart_mark(ui: &mut Ui) -> Response {
    let side = 0.8 * ui.text_style_height(&TextStyle::Body);
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(side), Sense::hover());
    let colour = ui.visuals().weak_text_color();
    let on_circle = |angle: f32| rect.center() + 0.35 * side * Vec2::angled(angle);
    let (begins, ends) = (-1.0_f32, 3.6_f32);
    let arc = (0..=16).map(|i| on_circle(begins + (ends - begins) * i as f32 / 16.0)).collect();
    ui.painter().line(arc, Stroke::new(0.08 * side, colour));
    let (end, ahead, outwards) =
        (on_circle(ends), 0.3 * side * Vec2::angled(ends + FRAC_PI_2), 0.2 * side * Vec2::angled(ends));
    let head = vec![end + ahead, end + outwards, end - outwards];
    ui.painter().add(Shape::convex_polygon(head, colour, Stroke::NONE));
    response
}

impl Row<'_> {
    /// Shows a value's widget; what is written and is no value yet stays in `unread`. Whether anything was changed.
    pub(super) fn show(
        &self,
        ui: &mut Ui,
        kind: &Kind,
        value: &mut Value,
        unread: &mut BTreeMap<String, String>,
    ) -> bool {
        match kind {
            Kind::Switch => {
                let mut is_on = value.as_bool().unwrap_or_default();
                self.told(ui.checkbox(&mut is_on, "")).changed().then(|| *value = is_on.into()).is_some()
            }
            Kind::Number(number) => self.number(ui, *number, value),
            Kind::Numbers(number, _) => {
                let mut changed = false;
                for value in value.as_array_mut().into_iter().flatten() {
                    changed |= self.number(ui, *number, value);
                }
                changed
            }
            Kind::Text => {
                let mut text = value.as_str().unwrap_or_default().to_owned();
                let response = ui.add(TextEdit::singleline(&mut text).desired_width(TEXT_WIDTH));
                self.told(response).changed().then(|| *value = text.into()).is_some()
            }
            Kind::Choice(choices) => self.choice(ui, choices, value),
            Kind::Optional(kind) => {
                let mut is_some = !value.is_null();
                let mut changed = false;
                if self.told(ui.checkbox(&mut is_some, "")).changed() {
                    *value = if is_some { kind.first_value() } else { Value::Null };
                    changed = true;
                }
                if is_some {
                    changed |= self.show(ui, kind, value, unread);
                }
                changed
            }
            Kind::Other => self.other(ui, value, unread),
        }
    }

    /// Gives a widget its name and its tooltip.
    fn told(&self, response: Response) -> Response {
        response.labelled_by(self.label).on_hover_ui(|ui| tooltip(ui, &(self.tooltip)()))
    }

    fn number(&self, ui: &mut Ui, number: Number, value: &mut Value) -> bool {
        let before = value.as_f64().unwrap_or_default();
        let mut now = before;
        let magnitude = before.abs();
        let speed = match number.whole {
            true => (0.01 * magnitude).max(0.05),
            false if magnitude > 0.0 => 0.005 * magnitude,
            false => 0.001,
        };
        let mut widget = DragValue::new(&mut now)
            .speed(speed)
            .range(number.least..=number.most)
            // What is half written is no value.
            .update_while_editing(false)
            .custom_formatter(move |value, _| number.text(value))
            .custom_parser(|text| text.replace('−', "-").trim().parse().ok().filter(|value: &f64| value.is_finite()));
        if number.whole {
            widget = widget.max_decimals(0);
        }
        let changed = self.told(ui.add(widget)).changed() && now != before;
        if changed {
            *value = number.value(now);
        }
        changed
    }

    fn choice(&self, ui: &mut Ui, choices: &[Choice], value: &mut Value) -> bool {
        let now = value.as_str().unwrap_or_default().to_owned();
        let mut wanted = None;
        let shown = ComboBox::from_id_salt(self.key).selected_text(&now).show_ui(ui, |ui| {
            for choice in choices {
                let mut entry = ui.selectable_label(choice.name == now, &choice.name);
                if !choice.documentation.is_empty() {
                    entry = entry.on_hover_text(&choice.documentation);
                }
                if entry.clicked() {
                    wanted = Some(choice.name.clone());
                }
            }
        });
        let _ = self.told(shown.response);
        let wanted = wanted.filter(|wanted| *wanted != now);
        wanted.map(|wanted| *value = wanted.into()).is_some()
    }

    /// Anything else, as it stands in a settings file.
    fn other(&self, ui: &mut Ui, value: &mut Value, unread: &mut BTreeMap<String, String>) -> bool {
        // As it is written as long as it is being written, whatever stands for the same.
        let id = ui.make_persistent_id(("text", self.key));
        let written = ui.data(|data| data.get_temp::<String>(id));
        let mut text = unread.get(self.key).cloned().or(written).unwrap_or_else(|| as_toml(value));
        let response = self.told(ui.add(TextEdit::singleline(&mut text).desired_width(TEXT_WIDTH)));
        if !response.changed() {
            if !response.has_focus() {
                ui.data_mut(|data| data.remove::<String>(id));
            }
            return false;
        }
        let read = format!("v = {text}").parse::<toml::Table>().ok().and_then(|mut table| table.remove("v"));
        match read.and_then(|read| serde_json::to_value(read).ok()) {
            Some(read) => {
                *value = read;
                unread.remove(self.key);
                ui.data_mut(|data| data.insert_temp(id, text));
            }
            None => {
                unread.insert(self.key.to_owned(), text);
            }
        }
        true
    }
}
