//! Messages over the large pane.

use std::collections::VecDeque;

use egui::{Align2, Area, Context, Frame, Id, Order, Rect, RichText, Stroke, Vec2};

use crate::engine::state::{Kind, Message, State};
use crate::theme;

/// How long a message is shown, in seconds. Errors stay until they are clicked away.
const SHOWN_S: f64 = 7.0;
/// Messages that are shown at once.
const AT_ONCE: usize = 4;

/// The messages that are shown.
#[derive(Default)]
pub(crate) struct Toasts {
    shown: VecDeque<(f64, Message)>,
    /// How many of the engine's were seen.
    seen: u64,
}

impl Toasts {
    /// Takes in what the engine has said since. Events are for the list alone.
    pub(crate) fn take(&mut self, state: &State, now_s: f64) {
        let new = usize::try_from(state.told - self.seen).unwrap_or(usize::MAX).min(state.messages.len());
        self.seen = state.told;
        for message in state.messages.iter().skip(state.messages.len() - new) {
            if message.kind != Kind::Event {
                self.shown.push_back((now_s, message.clone()));
            }
        }
        self.shown.retain(|(since, message)| message.kind == Kind::Error || now_s - since < SHOWN_S);
        while self.shown.len() > AT_ONCE {
            self.shown.pop_front();
        }
    }

    /// Shows them in the lower left of a pane.
    pub(crate) fn show(&mut self, ctx: &Context, pane: Rect) {
        let mut gone = None;
        for (place, (_, message)) in self.shown.iter().enumerate() {
            let above = (self.shown.len() - 1 - place) as f32;
            let at = pane.left_bottom() + Vec2::new(76.0, -10.0 - 38.0 * above);
            let area = Area::new(Id::unique(("toast", place)))
                .order(Order::Foreground)
                .pivot(Align2::LEFT_BOTTOM)
                .fixed_pos(at);
            area.show(ctx, |ui| {
                let stroke = Stroke::new(1.5, theme::message(message.kind));
                Frame::popup(ui.style()).stroke(stroke).show(ui, |ui| {
                    ui.set_max_width((pane.width() - 110.0).max(120.0));
                    ui.horizontal(|ui| {
                        ui.label(RichText::new(mark(message.kind)).color(theme::message(message.kind)));
                        ui.label(&message.text);
                        if ui.small_button("×").on_hover_text("Take this message away").clicked() {
                            gone = Some(place);
                        }
                    });
                });
            });
        }
        if let Some(place) = gone {
            self.shown.remove(place);
        }
        if !self.shown.is_empty() {
            ctx.request_repaint_after(std::time::Duration::from_secs(1));
        }
    }
}

/// A sign for how much a message matters, for those who see no colours.
pub(crate) const fn mark(kind: Kind) -> &'static str {
    match kind {
        Kind::Event => "•",
        Kind::Done => "✔",
        Kind::Warning => "⚠",
        Kind::Error => "✖",
    }
}
