//! The window of controls: what is shown and compared, the camera, the tour, screenshots.

use egui::{Align2, ComboBox, Context, Slider, Ui, Window, vec2};
use gs3::glam::DVec3;

use super::{Action, Facts, Panels};
use crate::compare::Compare;
use crate::controls::FOV;
use crate::path_file::PathFormat;
use crate::views::View;

/// Up axes that can be chosen.
pub const UPS: [(&str, DVec3); 6] = [
    ("+x", DVec3::X),
    ("−x", DVec3::NEG_X),
    ("+y", DVec3::Y),
    ("−y", DVec3::NEG_Y),
    ("+z", DVec3::Z),
    ("−z", DVec3::NEG_Z),
];

impl Panels {
    /// Shows the controls and adds what the user chose in them to `actions`.
    pub(super) fn show_menu(&mut self, context: &Context, facts: &Facts, actions: &mut Vec<Action>) {
        let mut is_open = true;
        Window::new("Controls")
            .open(&mut is_open)
            .anchor(Align2::RIGHT_TOP, vec2(-8.0, 8.0))
            .resizable(false)
            .collapsible(false)
            .show(context, |ui| {
                ui.spacing_mut().slider_width = 130.0;
                pick(ui, "view", View::ALL, facts.view, View::name, |view| actions.push(Action::View(view)));
                pick(ui, "compare", Compare::ALL, facts.compare, Compare::name, |compare| {
                    actions.push(Action::Compare(compare));
                });
                let mut fps = facts.fps;
                let slider = Slider::new(&mut fps, 5.0..=120.0).fixed_decimals(0).text("frames a second");
                if ui.add(slider).changed() {
                    actions.push(Action::Fps(fps));
                }
                let mut fov = facts.fov.to_degrees();
                let range = FOV[0].to_degrees()..=FOV[1].to_degrees();
                if ui.add(Slider::new(&mut fov, range).fixed_decimals(0).text("field of view, °")).changed()
                {
                    actions.push(Action::Fov(fov.to_radians()));
                }
                ui.horizontal(|ui| {
                    ui.label("up");
                    for (name, up) in UPS {
                        let is_up = facts.up.dot(up) > 0.999;
                        if ui.selectable_label(is_up, name).clicked() {
                            actions.push(Action::Up(up));
                        }
                    }
                });
                ui.horizontal(|ui| {
                    let buttons =
                        [("Open…", Action::Open), ("Frame", Action::Frame), ("Reset", Action::Reset)];
                    for (name, action) in buttons {
                        if ui.button(name).clicked() {
                            actions.push(action);
                        }
                    }
                });
                ui.separator();
                show_tour(ui, facts, actions);
                ui.separator();
                ui.horizontal(|ui| {
                    ui.label("screenshot");
                    for (name, scale) in [("1×", 1), ("2×", 2), ("4×", 4)] {
                        if ui.button(name).clicked() {
                            actions.push(Action::Shoot(scale));
                        }
                    }
                });
            });
        self.is_menu &= is_open;
    }
}

fn pick<T: Copy + PartialEq, const N: usize>(
    ui: &mut Ui,
    label: &str,
    all: [T; N],
    current: T,
    name: impl Fn(T) -> &'static str,
    mut picked: impl FnMut(T),
) {
    ComboBox::from_label(label).width(190.0).selected_text(name(current)).show_ui(ui, |ui| {
        for choice in all {
            if ui.selectable_label(choice == current, name(choice)).clicked() {
                picked(choice);
            }
        }
    });
}

fn show_tour(ui: &mut Ui, facts: &Facts, actions: &mut Vec<Action>) {
    ui.horizontal(|ui| {
        ui.label(format!("keyframes: {}", facts.keys));
        if ui.button("Add").clicked() {
            actions.push(Action::AddKey);
        }
        if ui.add_enabled(facts.keys > 0, egui::Button::new("Remove")).clicked() {
            actions.push(Action::RemoveKey);
        }
    });
    ui.horizontal(|ui| {
        ui.label("save");
        for (name, format) in
            [("camera path", PathFormat::CameraPath), ("SuperSplat", PathFormat::SuperSplat)]
        {
            if ui.add_enabled(facts.keys > 0, egui::Button::new(name)).clicked() {
                actions.push(Action::SaveTour(format));
            }
        }
        let can_begin = facts.tour_seconds > 0.0 && facts.video.is_none();
        if facts.has_videos && ui.add_enabled(can_begin, egui::Button::new("Video")).clicked() {
            actions.push(Action::Video);
        }
    });
    if facts.tour_seconds <= 0.0 {
        return;
    }
    ui.horizontal(|ui| {
        if ui.button(if facts.is_playing { "Stop" } else { "Play" }).clicked() {
            actions.push(Action::Play);
        }
        let mut seconds = facts.tour_time;
        let slider = Slider::new(&mut seconds, 0.0..=facts.tour_seconds).fixed_decimals(1).suffix(" s");
        if ui.add(slider).changed() {
            actions.push(Action::Scrub(seconds));
        }
    });
}
