//! The panels over the picture: figures, controls, help, messages.

mod menu;

use std::time::Duration;

use egui::{
    Align2, Area, Color32, Context, Event, FontId, Frame, Id, LayerId, Order, PointerButton, Pos2, RawInput,
    Rect, RichText, Stroke, Ui, Vec2, ViewportId, Window, pos2, vec2,
};
use gs3::glam::DVec3;

use crate::compare::Compare;
use crate::input::{Button, Input, Modifiers};
use crate::paint::{Framebuffer, Painter};
use crate::path_file::PathFormat;
use crate::views::View;
pub use menu::UPS;

/// The keys' functions, for the help.
const HELP: &[(&str, &str)] = &[
    ("left drag", "orbit around the pivot"),
    ("right drag", "pan"),
    ("wheel", "move towards the pivot"),
    ("double click", "set the pivot on the surface there"),
    ("W A S D, Q E", "fly, down and up; Shift fast, Ctrl slow"),
    ("F", "frame the scene"),
    ("R", "back to the first camera"),
    ("[ ]", "field of view"),
    ("U", "next up axis"),
    ("V", "next view: depth, normals, …"),
    ("C", "next comparison; drag its dividers"),
    ("K, Backspace", "add a keyframe, remove the last"),
    ("Space", "play or stop the keyframes"),
    ("P, O", "screenshot; open files"),
    ("M, I, H", "controls, figures, this help"),
    ("Escape", "close what is open"),
    ("drop a file", "open a scene or cameras"),
];

/// Requests of the panels.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Shows this.
    View(View),
    /// Compares this.
    Compare(Compare),
    /// Displays so many frames a second.
    Fps(f64),
    /// Sets the field of view, radians.
    Fov(f64),
    /// Sets the up axis.
    Up(DVec3),
    /// Adds a keyframe.
    AddKey,
    /// Removes the last keyframe.
    RemoveKey,
    /// Plays or stops.
    Play,
    /// Shows the tour's camera at this time, seconds.
    Scrub(f64),
    /// Writes the keyframes in this format.
    SaveTour(PathFormat),
    /// Renders the keyframes' path to a video.
    Video,
    /// Ends the video under way without a file.
    StopVideo,
    /// Asks for files to open.
    Open,
    /// Takes a screenshot, so many times larger.
    Shoot(u32),
    /// Frames the scene.
    Frame,
    /// Goes back to the first camera.
    Reset,
    /// Closes the message.
    Dismiss,
}

/// The contents of the panels.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Lines of figures.
    pub figures: Vec<String>,
    /// What cannot be done, and why; shown until the user closes it.
    pub message: Option<String>,
    /// What has been done; disappears on its own.
    pub note: Option<String>,
    /// Name of the file being opened, and the share that is done.
    pub opening: Option<(String, f32)>,
    /// Whether videos can be made.
    pub has_videos: bool,
    /// The share of the video under way that is done.
    pub video: Option<f32>,
    /// Whether a file is held over the window.
    pub is_hovering: bool,
    /// The view shown.
    pub view: View,
    /// The comparison shown.
    pub compare: Compare,
    /// First column of each part except the first, in pixels.
    pub dividers: Vec<usize>,
    /// Target of displayed frames per second.
    pub fps: f64,
    /// Vertical field of view, radians.
    pub fov: f64,
    /// The up axis.
    pub up: DVec3,
    /// Keyframes.
    pub keys: usize,
    /// Length of the tour, seconds.
    pub tour_seconds: f64,
    /// Whether the tour plays.
    pub is_playing: bool,
    /// Where the tour was shown last, seconds from its beginning.
    pub tour_time: f64,
}

/// The panels and their memory.
pub struct Panels {
    context: Context,
    painter: Painter,
    events: Vec<Event>,
    pointer: Pos2,
    modifiers: Modifiers,
    /// When panels must be painted again without an event.
    due: Option<Duration>,
    is_help: bool,
    is_menu: bool,
    is_figures: bool,
}

impl std::fmt::Debug for Panels {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Panels")
            .field("due", &self.due)
            .field("is_help", &self.is_help)
            .finish_non_exhaustive()
    }
}

impl Default for Panels {
    fn default() -> Self {
        let context = Context::default();
        context.set_theme(egui::Theme::Dark);
        context.all_styles_mut(|style| {
            // No animations: a viewer at rest paints nothing.
            style.animation_time = 0.0;
            style.visuals.override_text_color = Some(Color32::from_gray(220));
            style.visuals.window_shadow = egui::Shadow::NONE;
            style.visuals.popup_shadow = egui::Shadow::NONE;
            style.visuals.window_fill = Color32::from_rgba_unmultiplied(20, 20, 22, 235);
        });
        // Discs from a texture would need interpolation, which the painter does not have.
        context.tessellation_options_mut(|options| options.prerasterized_discs = false);
        Self {
            context,
            painter: Painter::default(),
            events: Vec::new(),
            pointer: Pos2::ZERO,
            modifiers: Modifiers::default(),
            due: None,
            is_help: false,
            is_menu: false,
            is_figures: true,
        }
    }
}

impl Panels {
    /// Passes `input` to the panels; points are of `scale` pixels.
    pub fn input(&mut self, input: &Input, scale: f32) {
        let modifiers = self.modifiers.to_egui();
        let event = match input {
            Input::PointerMoved([x, y]) => {
                self.pointer = pos2(x / scale, y / scale);
                Event::PointerMoved(self.pointer)
            }
            Input::PointerGone => Event::PointerGone,
            Input::Button(button, pressed) => Event::PointerButton {
                pos: self.pointer,
                button: match button {
                    Button::Left => PointerButton::Primary,
                    Button::Middle => PointerButton::Middle,
                    Button::Right => PointerButton::Secondary,
                },
                pressed: *pressed,
                modifiers,
            },
            Input::Wheel(lines) => Event::MouseWheel {
                unit: egui::MouseWheelUnit::Line,
                delta: vec2(0.0, *lines),
                phase: egui::TouchPhase::Move,
                source: egui::MouseWheelSource::Unknown,
                modifiers,
            },
            Input::Modifiers(modifiers) => {
                self.modifiers = *modifiers;
                Event::ModifiersChanged(modifiers.to_egui())
            }
            Input::Focused(is_focused) => Event::WindowFocused(*is_focused),
            // Keys belong to the viewer: no panel has text to type.
            Input::Touch(..)
            | Input::Key(..)
            | Input::Resized(_)
            | Input::Scale(_)
            | Input::Hovering(_)
            | Input::Dropped(_) => {
                return;
            }
        };
        self.events.push(event);
    }

    /// Whether a panel lies at `position` of the picture, in points of `scale` pixels.
    pub fn are_at(&self, position: [f32; 2], scale: f32) -> bool {
        let layer = self.context.layer_id_at(pos2(position[0] / scale, position[1] / scale));
        layer.is_some_and(|layer| layer.order != Order::Background)
    }

    /// When panels must be painted again without an event.
    pub const fn due(&self) -> Option<Duration> {
        self.due
    }

    /// Opens or closes the help.
    pub const fn toggle_help(&mut self) {
        self.is_help = !self.is_help;
    }

    /// Opens or closes the controls.
    pub const fn toggle_menu(&mut self) {
        self.is_menu = !self.is_menu;
    }

    /// Shows or hides the figures.
    pub const fn toggle_figures(&mut self) {
        self.is_figures = !self.is_figures;
    }

    /// Closes help and controls.
    pub const fn close(&mut self) {
        (self.is_help, self.is_menu) = (false, false);
    }

    /// Paints all panels over `picture` and returns the actions that the user chose in them.
    pub fn paint(
        &mut self,
        facts: &Facts,
        scale: f32,
        now: Duration,
        picture: &mut Framebuffer,
    ) -> Vec<Action> {
        let size = vec2(picture.size[0] as f32, picture.size[1] as f32) / scale;
        let mut input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, size)),
            time: Some(now.as_secs_f64()),
            events: std::mem::take(&mut self.events),
            focused: true,
            ..RawInput::default()
        };
        input.viewports.entry(ViewportId::ROOT).or_default().native_pixels_per_point = Some(scale);
        let mut actions = Vec::new();
        let context = self.context.clone();
        let mut output = context.run_ui(input, |_| self.show(facts, size, scale, &mut actions));
        let delay = output.viewport_output.get(&ViewportId::ROOT).map_or(Duration::MAX, |v| v.repaint_delay);
        self.due = now.checked_add(delay).filter(|_| delay < Duration::from_secs(60));
        let mut textures = std::mem::take(&mut output.textures_delta);
        self.painter.set_textures(&mut textures);
        let primitives = context.tessellate(output.shapes, output.pixels_per_point);
        self.painter.paint(&primitives, output.pixels_per_point, picture);
        self.painter.free_textures(&mut textures);
        actions
    }

    fn show(&mut self, facts: &Facts, size: Vec2, scale: f32, actions: &mut Vec<Action>) {
        let context = self.context.clone();
        show_dividers(&context, facts, size, scale);
        if self.is_figures {
            show_figures(&context, facts);
        }
        if self.is_menu {
            self.show_menu(&context, facts, actions);
        }
        if self.is_help {
            show_help(&context, size);
        }
        if let Some(share) = facts.video {
            show_video(&context, share, actions);
        }
        if let Some((name, share)) = &facts.opening {
            note(&context, "opening", &format!("opening {name}: {:.0} %", share * 100.0));
        } else if facts.is_hovering {
            note(&context, "hovering", "drop a scene or cameras to open them");
        } else if let Some(text) = &facts.note {
            note(&context, "note", text);
        }
        if let Some(message) = &facts.message {
            show_message(&context, message, size, actions);
        }
    }
}

/// Text that is not broken into lines.
fn line_of(ui: &mut Ui, text: RichText) {
    ui.add(egui::Label::new(text).wrap_mode(egui::TextWrapMode::Extend));
}

fn panel() -> Frame {
    Frame::new().fill(Color32::from_black_alpha(150)).corner_radius(4.0).inner_margin(8.0)
}

fn show_figures(context: &Context, facts: &Facts) {
    Area::new(Id::unique("figures")).fixed_pos(pos2(8.0, 8.0)).interactable(false).show(context, |ui| {
        panel().show(ui, |ui| {
            ui.spacing_mut().item_spacing.y = 2.0;
            for (k, line) in facts.figures.iter().enumerate() {
                let text = RichText::new(line).size(12.0);
                line_of(ui, if k == 0 { text.strong() } else { text.color(Color32::from_gray(210)) });
            }
        });
    });
}

fn show_help(context: &Context, size: Vec2) {
    /// Height of all lines, points.
    const TALL: f32 = 460.0;
    Window::new("Help")
        .anchor(Align2::CENTER_CENTER, Vec2::ZERO)
        .resizable(false)
        .collapsible(false)
        .vscroll(size.y < TALL)
        .max_height((size.y - 60.0).max(60.0))
        .show(context, |ui| {
            egui::Grid::new("keys").num_columns(2).spacing([16.0, 3.0]).show(ui, |ui| {
                for (keys, what) in HELP {
                    line_of(ui, RichText::new(*keys).strong());
                    line_of(ui, RichText::new(*what));
                    ui.end_row();
                }
            });
        });
}

fn show_message(context: &Context, message: &str, size: Vec2, actions: &mut Vec<Action>) {
    Window::new("This cannot be done")
        .anchor(Align2::CENTER_CENTER, Vec2::ZERO)
        .resizable(false)
        .collapsible(false)
        .show(context, |ui| {
            ui.set_max_width((size.x - 60.0).clamp(80.0, 460.0));
            ui.label(message);
            ui.add_space(6.0);
            if ui.button("Close").clicked() {
                actions.push(Action::Dismiss);
            }
        });
}

/// The video under way, over the picture even while the controls are closed.
fn show_video(context: &Context, share: f32, actions: &mut Vec<Action>) {
    Area::new(Id::unique("video")).anchor(Align2::LEFT_BOTTOM, vec2(8.0, -8.0)).show(context, |ui| {
        panel().show(ui, |ui| {
            ui.horizontal(|ui| {
                line_of(ui, RichText::new("video"));
                let text = format!("{:.0} %", share * 100.0);
                ui.add(egui::ProgressBar::new(share).desired_width(120.0).text(text));
                if ui.button("Cancel").clicked() {
                    actions.push(Action::StopVideo);
                }
            });
        });
    });
}

fn note(context: &Context, id: &str, text: &str) {
    Area::new(Id::unique(id)).anchor(Align2::CENTER_BOTTOM, vec2(0.0, -40.0)).interactable(false).show(
        context,
        |ui| {
            panel().show(ui, |ui| line_of(ui, RichText::new(text)));
        },
    );
}

/// Lines between the parts of a comparison, and the parts' names.
fn show_dividers(context: &Context, facts: &Facts, size: Vec2, scale: f32) {
    let methods = facts.compare.methods();
    if methods.len() < 2 {
        return;
    }
    let painter = context.layer_painter(LayerId::background());
    let places: Vec<f32> = facts.dividers.iter().map(|column| *column as f32 / scale).collect();
    for x in &places {
        painter.vline(*x, 0.0..=size.y, Stroke::new(2.0, Color32::from_white_alpha(160)));
    }
    let edges: Vec<f32> = std::iter::once(0.0).chain(places).chain([size.x]).collect();
    for (method, edge) in methods.iter().zip(edges.windows(2)) {
        let at = pos2(0.5 * (edge[0] + edge[1]), size.y - 10.0);
        for (offset, color) in [(1.0, Color32::BLACK), (0.0, Color32::WHITE)] {
            let at = at + vec2(offset, offset);
            painter.text(at, Align2::CENTER_BOTTOM, method.name(), FontId::proportional(15.0), color);
        }
    }
}
