//! `run`: runs the service until a signal stops it.

use std::{path::PathBuf, sync::Arc, time::Duration};

use anyhow::Context;
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::threads::{self, Heartbeat};
use mocapd_service::{
    config::{CONFIG_PATH, Config, ConfigError, HttpConfig, Overrides},
    control::Control,
    engine::{Engine, EngineOptions},
    http::{HttpOptions, HttpServer, Token},
    log::Log,
    notify::Notifier,
    publish::{self, RunningPublisher},
    status::ServiceEventKind,
    triggered::Triggers,
};
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};

use super::output::{notify, plain};

/// Interval of the status lines sent to systemd.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// Capacity of the channel of signals: one of each kind and one more; the kernel keeps one more of each kind pending.
const SIGNALS_MAX: usize = 4;

/// How long HTTP clients may finish their requests when the service stops; their takes are closed by then.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The configuration file
    #[arg(long, value_name = "FILE", default_value = CONFIG_PATH)]
    config: PathBuf,
    /// Device, instead of the configured one: serial:PATH[@BAUD], usb:VID:PID[:SERIAL], qtm:HOST[:PORT], natnet:HOST[:PORT], lsl:NAME, or auto
    #[arg(long, value_name = "DEVICE")]
    device: Option<String>,
    /// Folder for takes, instead of the configured one
    #[arg(long, value_name = "FOLDER")]
    directory: Option<String>,
    /// TCP address to listen on, instead of the configured one
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
    threads::install_fault_hooks()?;
    // Handlers are installed before anything starts, so that no signal is missed.
    let signals = signals()?;
    create_directory(&config)?;
    let options = EngineOptions::load(&config)?;
    let log = Log::start(config.log_level, &config.rig_name, std::io::stderr)?;
    let heartbeat = Heartbeat::default();
    let engine = Arc::new(Engine::start(options, &heartbeat)?);
    let control: Arc<dyn Control> = Arc::<Engine>::clone(&engine);
    for warning in config.warnings() {
        control.notify(ServiceEventKind::Warning, &warning);
    }
    let servers = Servers::open(&config, &engine, &control)?;
    let mut notifier = Notifier::default();
    notifier.ready(&engine.status().summary());
    let pings = Notifier::watch(&heartbeat)?;
    let mut running = RunningService { args, config, log, engine, control, servers, notifier };
    let outcome = running.until_stopped(&signals);
    running.notifier.stopping("finishing the take");
    running.engine.stop_service();
    running.servers.close();
    drop(pings);
    outcome.map(|()| Outcome::Done)
}

/// Starts a thread that receives signals; the channel that they arrive on.
fn signals() -> anyhow::Result<Receiver<i32>> {
    let mut signals =
        Signals::new([SIGHUP, SIGINT, SIGTERM]).context("cannot watch for signals")?;
    let (sender, receiver) = bounded(SIGNALS_MAX);
    threads::spawn("mocapd-signal", move || {
        for signal in signals.forever() {
            // The receiver is gone: the program ends.
            if sender.send(signal).is_err() {
                return;
            }
        }
    })?;
    Ok(receiver)
}

/// The servers that requests arrive on: HTTP, capture triggers, and clients of publishers.
struct Servers {
    http: Option<HttpServer>,
    triggers: Option<Triggers>,
    publishers: Vec<RunningPublisher>,
}

impl Servers {
    fn open(config: &Config, engine: &Engine, control: &Arc<dyn Control>) -> anyhow::Result<Self> {
        let mut options = http_options(&config.http)?;
        if config.missing_socket_folder().is_some() {
            options.unix_socket = None;
        }
        let is_on = options.unix_socket.is_some() || options.tcp.is_some();
        let http = is_on.then(|| HttpServer::start(options, Arc::clone(control))).transpose()?;
        if let Some(address) = http.as_ref().and_then(HttpServer::tcp_address) {
            control
                .notify(ServiceEventKind::State, &format!("the dashboard is at http://{address}/"));
        }
        let triggers = Triggers::open(&config.trigger, &config.rig_name, control)?;
        let publishers = publish::open_all(config, |name| engine.published(name), control)?;
        Ok(Self { http, triggers, publishers })
    }

    /// Applies those changes of a new configuration that take effect immediately.
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
        RunningPublisher::close_all(self.publishers);
        if let Some(triggers) = self.triggers {
            triggers.close();
        }
        if let Some(http) = self.http
            && let Err(error) = http.stop(SHUTDOWN_TIMEOUT)
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

struct RunningService<'a> {
    args: &'a Args,
    config: Config,
    log: Log,
    engine: Arc<Engine>,
    control: Arc<dyn Control>,
    servers: Servers,
    notifier: Notifier,
}

impl RunningService<'_> {
    fn until_stopped(&mut self, signals: &Receiver<i32>) -> anyhow::Result<()> {
        loop {
            match signals.recv_timeout(STATUS_INTERVAL) {
                Ok(SIGHUP) => self.reload(),
                Ok(_) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {
                    self.notifier.status(&self.engine.status().summary());
                }
                Err(RecvTimeoutError::Disconnected) => {
                    anyhow::bail!("the signal thread has ended: please report this bug")
                }
            }
            if self.engine.has_died() {
                anyhow::bail!("a thread of the service has ended: please report this bug");
            }
        }
    }

    /// Reads the configuration again and applies it; an invalid one changes nothing.
    fn reload(&mut self) {
        self.notifier.reloading();
        match self.args.load() {
            Ok(config) => self.apply(config),
            Err(error) => {
                tracing::error!("keeping the old configuration: {}", plain(&error.to_string()));
            }
        }
        self.notifier.ready(&self.engine.status().summary());
    }

    fn apply(&mut self, mut config: Config) {
        let changes = self.config.changes(&config);
        for change in &changes {
            tracing::info!("{}: {}", change.key, change.when.description());
        }
        let options = match create_directory(&config).and_then(|()| EngineOptions::load(&config)) {
            Ok(options) => options,
            Err(error) => {
                tracing::error!("keeping the old configuration: {}", plain(&format!("{error:#}")));
                return;
            }
        };
        self.log.set_level(config.log_level);
        self.engine.reload(options);
        let known = self.config.warnings();
        for warning in config.warnings().iter().filter(|warning| !known.contains(warning)) {
            self.control.notify(ServiceEventKind::Warning, warning);
        }
        if let Err(error) = self.servers.reload(&self.config, &config, &self.control) {
            tracing::error!("{}", plain(&format!("{error:#}")));
            // The next reload then differs from this one, and tries again.
            config.trigger.listen = None;
        }
        self.config = config;
    }
}

/// Creates the folder for takes if it does not exist, so that a folder that cannot be written to is reported now and
/// not when a recording starts.
fn create_directory(config: &Config) -> anyhow::Result<()> {
    config.check_takes_folder()?;
    let directory = &config.take.directory;
    if directory.exists() {
        return Ok(());
    }
    std::fs::create_dir_all(directory)
        .with_context(|| format!("cannot create the takes' folder {}", directory.display()))?;
    notify(&format!("created the folder {}", directory.display()));
    Ok(())
}
