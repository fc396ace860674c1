//! The package and the service, under Debian's systemd, udev, journal and dpkg.

mod life;
mod package;
mod plug;
mod rig;
mod troubled;

use crate::Scenario;

pub(crate) use rig::prepare;

/// The order matters: the first installs the package, the last removes it.
pub(crate) const ALL: &[(&str, Scenario)] = &[
    ("package: installation, user and folders", package::installs),
    ("package: units are valid and sandboxed", package::units),
    ("package: manual and completions", package::manual),
    ("service: ready without a device", life::ready_without_a_device),
    ("service: a configuration that is refused", life::refused),
    ("service: records the simulated rig", life::records),
    ("service: accepts triggers from other programs", life::triggered),
    ("service: access for the group only", life::group_access),
    ("service: reloads its configuration", life::reloads),
    ("service: fields in the journal", life::journal),
    ("service: a stop finishes the take", life::stops),
    ("trouble: kill -9", troubled::killed),
    ("trouble: the data plane hangs", troubled::hangs),
    ("plug: a rig starts its own service", plug::starts),
    ("plug: a port whose driver comes later", plug::driver_comes_later),
    ("package: doctor reports the service", package::doctor),
    ("package: upgrades and removals", package::removed),
];
