//! winit's events as inputs.

use gs3::scene::Size;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, TouchPhase, WindowEvent};
use winit::keyboard::{Key as WinitKey, NamedKey};

use crate::input::{Button, Input, Key, Modifiers, Touch};

/// Pixels of a touch pad that count as a line of a wheel: what browsers and desktops take.
const PIXELS_PER_LINE: f64 = 40.0;

/// What `event` means for the viewer.
pub fn inputs(event: &WindowEvent) -> Vec<Input> {
    match event {
        WindowEvent::Resized(size) => vec![Input::Resized(Size::new(size.width, size.height))],
        WindowEvent::ScaleFactorChanged { scale_factor, .. } => vec![Input::Scale(*scale_factor as f32)],
        WindowEvent::CursorMoved { position, .. } => {
            vec![Input::PointerMoved([position.x as f32, position.y as f32])]
        }
        WindowEvent::CursorLeft { .. } => vec![Input::PointerGone],
        WindowEvent::MouseInput { state, button, .. } => {
            let button = match button {
                MouseButton::Left => Button::Left,
                MouseButton::Middle => Button::Middle,
                MouseButton::Right => Button::Right,
                MouseButton::Back | MouseButton::Forward | MouseButton::Other(_) => return Vec::new(),
            };
            vec![Input::Button(button, *state == ElementState::Pressed)]
        }
        WindowEvent::Touch(touch) => {
            let phase = match touch.phase {
                TouchPhase::Started => Touch::Began,
                TouchPhase::Moved => Touch::Moved,
                TouchPhase::Ended | TouchPhase::Cancelled => Touch::Ended,
            };
            vec![Input::Touch(touch.id, phase, [touch.location.x as f32, touch.location.y as f32])]
        }
        WindowEvent::MouseWheel { delta, .. } => vec![Input::Wheel(match delta {
            MouseScrollDelta::LineDelta(_, lines) => *lines,
            MouseScrollDelta::PixelDelta(pixels) => (pixels.y / PIXELS_PER_LINE) as f32,
        })],
        WindowEvent::KeyboardInput { event, .. } => {
            let is_pressed = event.state == ElementState::Pressed;
            // A held key is held already.
            match key(&event.logical_key).filter(|_| !event.repeat) {
                Some(key) => vec![Input::Key(key, is_pressed)],
                None => Vec::new(),
            }
        }
        WindowEvent::ModifiersChanged(modifiers) => {
            let state = modifiers.state();
            vec![Input::Modifiers(Modifiers {
                shift: state.shift_key(),
                ctrl: state.control_key(),
                alt: state.alt_key(),
            })]
        }
        WindowEvent::HoveredFile(_) => vec![Input::Hovering(true)],
        WindowEvent::HoveredFileCancelled => vec![Input::Hovering(false)],
        WindowEvent::DroppedFile(file) => vec![Input::Dropped(file.clone())],
        WindowEvent::Focused(is_focused) => vec![Input::Focused(*is_focused)],
        _ => Vec::new(),
    }
}

/// A key by the letter on it, so that W is W on every keyboard.
fn key(key: &WinitKey) -> Option<Key> {
    match key {
        WinitKey::Named(NamedKey::Space) => Some(Key::Space),
        WinitKey::Named(NamedKey::Escape) => Some(Key::Escape),
        WinitKey::Named(NamedKey::Backspace) => Some(Key::Backspace),
        WinitKey::Character(text) => Key::from_name(&text.to_uppercase()).or_else(|| Key::from_name(text)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_keys_whatever_their_case() {
        let named = |text: &str| key(&WinitKey::Character(text.into()));
        assert_eq!((named("w"), named("W")), (Some(Key::W), Some(Key::W)));
        assert_eq!((named("["), named("]")), (Some(Key::OpenBracket), Some(Key::CloseBracket)));
        assert_eq!(named("ß"), None);
        assert_eq!(key(&WinitKey::Named(NamedKey::Space)), Some(Key::Space));
    }
}
