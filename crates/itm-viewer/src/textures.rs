//! Pictures as egui knows them.

use std::sync::Arc;

use eframe::egui_wgpu::{RenderState, wgpu};
use egui::{ColorImage, Context, TextureHandle, TextureId, TextureOptions};
use itm_slam::{Canvas, ColourImage};

/// The textures of what is shown.
#[derive(Default)]
pub(crate) struct Textures {
    /// Where the window draws; none in tests that draw nothing.
    render_state: Option<RenderState>,
    /// Canvases, each with the texture that it is.
    canvases: Vec<(Arc<Canvas>, TextureId)>,
    depth: Option<Uploaded>,
    colour: Option<Uploaded>,
}

/// An image of the host, and the texture that it was copied to.
struct Uploaded {
    image: Arc<ColourImage>,
    texture: TextureHandle,
}

/// Which of a frame's images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    Depth,
    Colour,
}

/// Canvases that are remembered, so that those in use in turn are not registered anew each time.
const CANVASES: usize = 6;

impl Textures {
    pub(crate) fn new(render_state: Option<RenderState>) -> Self {
        Self { render_state, ..Self::default() }
    }

    /// The texture that a canvas is: nothing is copied.
    pub(crate) fn of_canvas(&mut self, canvas: &Arc<Canvas>) -> Option<TextureId> {
        if let Some((_, id)) = self.canvases.iter().find(|(known, _)| Arc::ptr_eq(known, canvas)) {
            return Some(*id);
        }
        let render_state = self.render_state.as_ref()?;
        let view = canvas.texture().create_view(&wgpu::TextureViewDescriptor::default());
        let mut renderer = render_state.renderer.write();
        if self.canvases.len() >= CANVASES {
            let (_, oldest) = self.canvases.remove(0);
            renderer.free_texture(&oldest);
        }
        let id = renderer.register_native_texture(&render_state.device, &view, wgpu::FilterMode::Linear);
        self.canvases.push((Arc::clone(canvas), id));
        Some(id)
    }

    /// The texture of a frame's image, copied where it is a new one.
    pub(crate) fn of_image(&mut self, ctx: &Context, which: Which, image: &Arc<ColourImage>) -> TextureId {
        let (held, name) = match which {
            Which::Depth => (&mut self.depth, "depth"),
            Which::Colour => (&mut self.colour, "colour"),
        };
        match held {
            Some(held) if Arc::ptr_eq(&held.image, image) => held.texture.id(),
            Some(held) => {
                held.texture.set(to_egui(image), TextureOptions::LINEAR);
                held.image = Arc::clone(image);
                held.texture.id()
            }
            None => {
                let texture = ctx.load_texture(name, to_egui(image), TextureOptions::LINEAR);
                held.insert(Uploaded { image: Arc::clone(image), texture }).texture.id()
            }
        }
    }
}

fn to_egui(image: &ColourImage) -> ColorImage {
    let (width, height) = image.size();
    // Colour images have an alpha of 0 where their lens shows nothing.
    let rgb: Vec<u8> = image.data().iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
    ColorImage::from_rgb([width as usize, height as usize], &rgb)
}
