//! `run`: the service, until it is told to stop.

use std::{path::PathBuf, sync::Arc, time::Duration};

use anyhow::Context;
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{heartbeat::Heartbeat, threads};
use mocapd_service::{
    config::{CONFIG_PATH, Config, ConfigError, HttpConfig, Overrides},
    control::Control,
    engine::{Engine, EngineOptions},
    http::{HttpOptions, HttpServer, Token},
    log::Log,
    notify::Notifier,
    status::ServiceEventKind,
    triggered::Triggers,
};
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};

use super::output::{plain, say};

/// Between two lines of status that systemd is told.
const TELL_EVERY: Duration = Duration::from_secs(1);

/// Signals that wait: one of each kind and more; the kernel keeps one of each kind beside them.
const SIGNALS_MAX: usize = 4;

/// How long clients are waited for when the service stops: their takes are closed by then.
const CLIENTS_WITHIN: Duration = Duration::from_secs(1);

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The configuration
    #[arg(long, value_name = "FILE", default_value = CONFIG_PATH)]
    config: PathBuf,
    /// The device, whatever the configuration says: serial:PATH[@BAUD], usb:VID:PID[:SERIAL], or auto
    #[arg(long, value_name = "DEVICE")]
    device: Option<String>,
    /// The takes' folder, whatever the configuration says
    #[arg(long, value_name = "FOLDER")]
    directory: Option<String>,
    /// The TCP address, whatever the configuration says
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
}

impl Args {
    fn load(&self) -> Result<Config, ConfigError> {
        let overrides = Overrides {
            device: self.device.clone(),
            directory: self.directory.clone(),
            listen: self.listen.clone(),
        };
        Config::load(&self.config, &overrides)
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let config = args.load().map_err(|error| match error {
        ConfigError::Refused { .. } => UsageError(error.to_string()).into(),
        error => anyhow::Error::from(error),
    })?;
    #[cfg(feature = "fault-hooks")]
    mocapd_acquire::heartbeat::fault_hooks::install()?;
    // Before anything is started: no signal is missed.
    let signals = signals()?;
    make_directory(&config)?;
    let options = EngineOptions::load(&config)?;
    let log = Log::start(config.log_level, &config.rig_name, std::io::stderr)?;
    let heartbeat = Heartbeat::default();
    let engine = Arc::new(Engine::start(options, &heartbeat)?);
    let control: Arc<dyn Control> = Arc::<Engine>::clone(&engine);
    for warning in config.warnings() {
        control.tell(ServiceEventKind::Warning, &warning);
    }
    let doors = Doors::open(&config, &control)?;
    let mut notifier = Notifier::default();
    notifier.ready(&engine.status().words());
    let pings = Notifier::watch(&heartbeat)?;
    let mut running = Running { args, config, log, engine, control, doors, notifier };
    let outcome = running.until_stopped(&signals);
    running.notifier.stopping("finishing the take");
    running.engine.stop_service();
    running.doors.close();
    drop(pings);
    outcome.map(|()| Outcome::Done)
}

/// Signals, as they come.
fn signals() -> anyhow::Result<Receiver<i32>> {
    let mut signals =
        Signals::new([SIGHUP, SIGINT, SIGTERM]).context("cannot watch for signals")?;
    let (heard, come) = bounded(SIGNALS_MAX);
    threads::spawn("mocapd-signal", move || {
        for signal in signals.forever() {
            // Nobody listens any more: the program ends.
            if heard.send(signal).is_err() {
                return;
            }
        }
    })?;
    Ok(come)
}

/// Ways in.
struct Doors {
    http: Option<HttpServer>,
    triggers: Option<Triggers>,
}

impl Doors {
    fn open(config: &Config, control: &Arc<dyn Control>) -> anyhow::Result<Self> {
        let mut options = http_options(&config.http)?;
        if config.missing_socket_folder().is_some() {
            options.unix_socket = None;
        }
        let wanted = options.unix_socket.is_some() || options.tcp.is_some();
        let http = wanted.then(|| HttpServer::start(options, Arc::clone(control))).transpose()?;
        if let Some(address) = http.as_ref().and_then(HttpServer::tcp_address) {
            control
                .tell(ServiceEventKind::State, &format!("the dashboard is at http://{address}/"));
        }
        let triggers = Triggers::open(&config.trigger, &config.rig_name, control)?;
        Ok(Self { http, triggers })
    }

    /// Takes over what another configuration says at once.
    fn reload(
        &mut self,
        was: &Config,
        now: &Config,
        control: &Arc<dyn Control>,
    ) -> anyhow::Result<()> {
        if let Some(http) = &self.http {
            http.allow_hosts(now.http.allowed_hosts.clone());
        }
        if was.trigger != now.trigger || was.rig_name != now.rig_name {
            if let Some(triggers) = self.triggers.take() {
                triggers.close();
            }
            self.triggers = Triggers::open(&now.trigger, &now.rig_name, control)?;
        }
        Ok(())
    }

    fn close(self) {
        if let Some(triggers) = self.triggers {
            triggers.close();
        }
        if let Some(http) = self.http
            && let Err(error) = http.stop(CLIENTS_WITHIN)
        {
            tracing::error!("{}", plain(&format!("{error:#}")));
        }
    }
}

fn http_options(config: &HttpConfig) -> anyhow::Result<HttpOptions> {
    let token = config.token_file.as_deref().map(Token::read).transpose()?;
    Ok(HttpOptions {
        unix_socket: config.socket.clone(),
        tcp: config.listen,
        token: token.map(Token::into_text),
        allowed_hosts: config.allowed_hosts.clone(),
        connections_max: config.connections_max,
        ..HttpOptions::default()
    })
}

struct Running<'a> {
    args: &'a Args,
    config: Config,
    log: Log,
    engine: Arc<Engine>,
    control: Arc<dyn Control>,
    doors: Doors,
    notifier: Notifier,
}

impl Running<'_> {
    fn until_stopped(&mut self, signals: &Receiver<i32>) -> anyhow::Result<()> {
        loop {
            match signals.recv_timeout(TELL_EVERY) {
                Ok(SIGHUP) => self.reload(),
                Ok(_) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {
                    self.notifier.status(&self.engine.status().words());
                }
                Err(RecvTimeoutError::Disconnected) => {
                    anyhow::bail!("nobody watches for signals any more: this is a bug in mocapd")
                }
            }
            if self.engine.has_died() {
                anyhow::bail!("a thread of the service has ended: this is a bug in mocapd");
            }
        }
    }

    /// A configuration that cannot be meant changes nothing.
    fn reload(&mut self) {
        self.notifier.reloading();
        match self.args.load() {
            Ok(config) => self.take_over(config),
            Err(error) => {
                tracing::error!("the configuration stays as it was: {}", plain(&error.to_string()));
            }
        }
        self.notifier.ready(&self.engine.status().words());
    }

    fn take_over(&mut self, mut config: Config) {
        let changes = self.config.changes(&config);
        for change in &changes {
            tracing::info!("{}: {}", change.key, change.when.words());
        }
        let options = match make_directory(&config).and_then(|()| EngineOptions::load(&config)) {
            Ok(options) => options,
            Err(error) => {
                tracing::error!(
                    "the configuration stays as it was: {}",
                    plain(&format!("{error:#}"))
                );
                return;
            }
        };
        self.log.set_level(config.log_level);
        self.engine.reload(options);
        let known = self.config.warnings();
        for warning in config.warnings().iter().filter(|warning| !known.contains(warning)) {
            self.control.tell(ServiceEventKind::Warning, warning);
        }
        if let Err(error) = self.doors.reload(&self.config, &config, &self.control) {
            tracing::error!("{}", plain(&format!("{error:#}")));
            // Tried again the next time.
            config.trigger.listen = None;
        }
        self.config = config;
    }
}

/// Makes the takes' folder where it does not exist: whether it can be written is known before anybody presses record.
fn make_directory(config: &Config) -> anyhow::Result<()> {
    config.check_takes_folder()?;
    let directory = &config.take.directory;
    if directory.exists() {
        return Ok(());
    }
    std::fs::create_dir_all(directory)
        .with_context(|| format!("cannot make the takes' folder {}", directory.display()))?;
    say(&format!("made the folder {}", directory.display()));
    Ok(())
}
