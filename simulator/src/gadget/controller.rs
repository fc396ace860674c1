//! Which controller the gadget sits on, and what an earlier simulator left behind.

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use usb_gadget::{Udc, registered, udcs};

use super::GadgetError;

/// How gadgets of ours are called in configfs, before the process that made them.
const NAME: &str = "mocapd-sim-";

/// A controller that was free.
#[derive(Debug)]
pub(super) struct Controller(Udc);

impl Controller {
    /// The one of that name, or the first that is free, by name.
    pub(super) fn choose(wanted: Option<&str>) -> Result<Self, GadgetError> {
        let mut all = udcs().unwrap_or_default();
        if all.is_empty() {
            return Err(GadgetError::NoController);
        }
        remove_leftovers();
        all.sort_by_key(|udc| udc.name().to_owned());
        let names: Vec<_> = all.iter().map(|udc| udc.name().to_string_lossy()).collect();
        let found = names.join(", ");
        if let Some(name) = wanted
            && !names.iter().any(|known| known == name)
        {
            return Err(GadgetError::NoSuchController { name: name.to_owned(), found });
        }
        let is_meant = |udc: &Udc| wanted.is_none_or(|name| udc.name() == name);
        let is_free = |udc: &Udc| udc.function().is_ok_and(|gadget| gadget.is_none());
        let free = all.iter().find(|udc| is_meant(udc) && is_free(udc)).cloned();
        free.map(Self).ok_or(GadgetError::ControllerBusy { found })
    }

    pub(super) fn udc(&self) -> &Udc {
        &self.0
    }

    pub(super) fn name(&self) -> String {
        self.0.name().to_string_lossy().into_owned()
    }
}

/// A name for a gadget of this process.
pub(super) fn gadget_name() -> String {
    static MADE: AtomicU32 = AtomicU32::new(0);
    format!("{NAME}{}-{}", std::process::id(), MADE.fetch_add(1, Ordering::Relaxed))
}

/// A simulator that was killed could not take its gadget away.
fn remove_leftovers() {
    for gadget in registered().unwrap_or_default() {
        let name = gadget.name().to_string_lossy().into_owned();
        let process = name.strip_prefix(NAME).and_then(|rest| rest.split('-').next());
        let is_left = process.is_some_and(|process| !Path::new("/proc").join(process).exists());
        if is_left && gadget.remove().is_err() {
            // Then its controller counts as taken, and the error says so.
        }
    }
}
