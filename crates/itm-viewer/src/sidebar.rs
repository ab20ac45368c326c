//! Depth, colour, plots and messages.

use std::sync::Arc;

use egui::{Color32, Mesh, Pos2, Rect, RichText, ScrollArea, Sense, Ui, Vec2};
use itm_slam::ColourImage;

use crate::app::Viewer;
use crate::engine::scale_colour;
use crate::plots::{self, Plotted};
use crate::textures::Which;
use crate::theme;
use crate::toasts::mark;

impl Viewer {
    pub(crate) fn sidebar(&mut self, ui: &mut Ui) {
        egui::Panel::right("side").default_size(300.0).size_range(200.0..=560.0).show(ui, |ui| {
            ui.add_space(4.0);
            let (depth, colour, view) = {
                let state = self.engine.state();
                (state.depth.clone(), state.colour.clone(), state.settings.view.clone())
            };
            // A third of the room for each of images, plot and messages.
            let height = (0.23 * ui.available_height()).clamp(60.0, 260.0);
            self.image(ui, Which::Depth, depth.as_ref(), height);
            depth_scale(ui, view.max_depth_m);
            ui.add_space(4.0);
            if colour.is_some() || depth.is_none() {
                self.image(ui, Which::Colour, colour.as_ref(), height);
            }
            ui.add_space(4.0);
            ui.horizontal(|ui| {
                for (plotted, name, about) in Plotted::ALL {
                    ui.selectable_value(&mut self.plotted, plotted, name).on_hover_text(about);
                }
            });
            let guard = self.engine.state();
            plots::show(ui, &guard, self.plotted, (0.45 * ui.available_height()).clamp(90.0, 320.0));
            ui.separator();
            ui.label(RichText::new("What happened").strong());
            ScrollArea::vertical().auto_shrink(false).stick_to_bottom(true).show(ui, |ui| {
                for message in &guard.messages {
                    ui.horizontal_wrapped(|ui| {
                        ui.spacing_mut().item_spacing.x = 4.0;
                        ui.label(RichText::new(mark(message.kind)).color(theme::message(message.kind)));
                        if let Some(frame) = message.frame {
                            ui.label(RichText::new(frame.to_string()).weak());
                        }
                        ui.label(&message.text);
                    });
                }
            });
        });
    }

    /// An image as wide as the room, or a place for one.
    fn image(&mut self, ui: &mut Ui, which: Which, image: Option<&Arc<ColourImage>>, height: f32) {
        let aspect = image.map_or(0.75, |image| image.height() as f32 / image.width() as f32);
        let width = ui.available_width().min(height / aspect);
        let (rect, _) = ui.allocate_exact_size(Vec2::new(ui.available_width(), width * aspect), Sense::hover());
        let rect = Rect::from_center_size(rect.center(), Vec2::new(width, width * aspect));
        match image {
            Some(image) => {
                let texture = self.textures.of_image(ui.ctx(), which, image);
                ui.painter().image(texture, rect, Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0)), Color32::WHITE);
            }
            None => {
                let name = if which == Which::Depth { "depth" } else { "colour" };
                ui.painter().rect_filled(rect, 3.0, ui.visuals().extreme_bg_color);
                let font = egui::FontId::proportional(13.0);
                ui.painter().text(
                    rect.center(),
                    egui::Align2::CENTER_CENTER,
                    name,
                    font,
                    ui.visuals().weak_text_color(),
                );
            }
        }
    }
}

/// What the colours of depth mean.
fn depth_scale(ui: &mut Ui, max_depth_m: f32) {
    ui.horizontal(|ui| {
        ui.small("0 m");
        let far = format!("{max_depth_m} m");
        let width = ui.available_width() - 34.0;
        let (rect, response) = ui.allocate_exact_size(Vec2::new(width.max(10.0), 9.0), Sense::hover());
        let mut mesh = Mesh::default();
        let steps = 24u32;
        for step in 0..=steps {
            let share = step as f32 / steps as f32;
            let [r, g, b] = scale_colour(share);
            let x = egui::lerp(rect.x_range(), share);
            for y in [rect.top(), rect.bottom()] {
                mesh.colored_vertex(Pos2::new(x, y), Color32::from_rgb(r, g, b));
            }
            if step > 0 {
                let at = 2 * step;
                mesh.add_triangle(at - 2, at - 1, at);
                mesh.add_triangle(at - 1, at, at + 1);
            }
        }
        ui.painter().add(mesh);
        response.on_hover_text(
            "Depth; black where nothing was measured, or out of the range of view.min_depth_m and view.max_depth_m",
        );
        ui.small(far);
    });
}
