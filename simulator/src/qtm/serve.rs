//! A simulated QTM on the network: one thread that sleeps until the next frame, client or byte.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::num::NonZeroU64;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use mocapd_drivers::qtm::{
    ClientId, DISCOVERY_PORT, QtmServer, discovery_reply, read_discovery_request,
};
use mocapd_drivers::transport::network::responder::Responder;
use mocapd_drivers::transport::network::server::{StreamServer, TcpServer};

use super::{QtmDevice, VERSION};
use crate::NetworkOptions;
use crate::device::FateLog;
use crate::device::SentLog;
use crate::line::host_ns;

/// The longest sleep, which bounds the reaction time to a stop.
const SLEEP_MAX: Duration = Duration::from_millis(20);

/// How long clients have to take what is pending when the server ends.
const DRAIN: Duration = Duration::from_secs(1);

/// Why serving failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The port cannot be opened.
    #[error("cannot listen on TCP port {port} of this machine ({}): end the program that uses it, or give another port", source.kind())]
    Listen {
        /// The port.
        port: u16,
        /// The system's error.
        source: io::Error,
    },
    /// A call to the system failed.
    #[error("{action} failed")]
    Network {
        /// The operation.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The log of sent frames could not be written.
    #[error("cannot write the log of sent frames")]
    Log(#[source] io::Error),
}

/// A port of this machine, on the loopback interface: a simulator is for this machine's programs.
#[derive(Debug)]
pub struct QtmListener {
    clients: TcpServer<ClientId>,
    datagrams: UdpSocket,
    responder: Option<Responder>,
}

impl QtmListener {
    /// Opens a port; 0 for any free one.
    ///
    /// # Errors
    /// When another program uses the port, or the system refuses it.
    pub fn open(port: u16) -> Result<Self, ServeError> {
        let failed = |source| ServeError::Listen { port, source };
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let clients = TcpServer::open(address).map_err(failed)?;
        let datagrams = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))
            .and_then(|socket| socket.set_nonblocking(true).map(|()| socket))
            .map_err(|source| ServeError::Network { action: "opening a UDP socket", source })?;
        Ok(Self { clients, datagrams, responder: None })
    }

    /// Answers searches of this machine's programs from now on. Returns `false` where another program keeps others from
    /// answering.
    pub fn answer_searches(&mut self) -> bool {
        self.responder = Responder::open(DISCOVERY_PORT).ok();
        self.responder.is_some()
    }

    /// Where clients connect.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.clients.address()
    }

    /// The URI that a recorder opens.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("qtm:{}", self.address())
    }

    /// Serves a device until `stop` is set.
    ///
    /// # Errors
    /// When the system fails to wait for the clients, or the log fails.
    pub fn serve(
        mut self,
        device: &mut QtmDevice,
        options: NetworkOptions,
        stop: &AtomicBool,
    ) -> Result<SentLog, ServeError> {
        // As for a line: a sleep must not be 50 us late. If the kernel refuses, it stays.
        rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).ok();
        let mut log = FateLog::begin(options.log).map_err(ServeError::Log)?;
        if log.is_kept() {
            device.keep_frame_log();
        }
        while !stop.load(Ordering::Relaxed) {
            let wake_ns = device.poll(host_ns());
            self.follow_cable(device)?;
            self.send_datagrams(device);
            if let Some(responder) = self.responder.as_mut().filter(|_| device.is_reachable()) {
                let port = self.clients.address().port();
                responder.serve(|from, question| {
                    let reply_port = read_discovery_request(question)?;
                    let reply = || discovery_reply("localhost", VERSION, port);
                    from.is_loopback().then(|| (reply_port, reply()))
                });
            }
            let mut clients = Clients(device);
            self.clients.exchange(&mut clients);
            log.add(device.take_fates()).map_err(ServeError::Log)?;
            if options.once && device.has_ended() && device.is_all_sent() {
                break;
            }
            let sleep = Duration::from_nanos(wake_ns.saturating_sub(host_ns())).min(SLEEP_MAX);
            let waited = self.clients.wait(&mut Clients(device), sleep);
            waited
                .map_err(|source| ServeError::Network { action: "waiting for clients", source })?;
        }
        self.send_datagrams(device);
        self.clients.finish(&mut Clients(device), DRAIN);
        device.close();
        log.add(device.take_fates()).map_err(ServeError::Log)?;
        log.finish().map_err(ServeError::Log)?;
        Ok(device.log())
    }

    /// Sends what is due. A datagram that the system does not take is lost, as on any network.
    fn send_datagrams(&self, device: &mut QtmDevice) {
        device.send_datagrams(|datagram| {
            self.datagrams.send_to(&datagram.bytes, datagram.to).is_ok()
        });
    }

    /// Closes the port while the device cannot be reached, and opens it again.
    fn follow_cable(&mut self, device: &QtmDevice) -> Result<(), ServeError> {
        if !device.is_reachable() {
            self.clients.unplug();
            return Ok(());
        }
        let port = self.clients.address().port();
        self.clients.plug().map_err(|source| ServeError::Listen { port, source })
    }
}

/// A device, and the time.
struct Clients<'a>(&'a mut QtmDevice);

impl StreamServer for Clients<'_> {
    type Id = ClientId;

    fn connect(&mut self, peer: SocketAddr) -> Result<ClientId, Vec<u8>> {
        self.0.connect(peer).ok_or_else(QtmServer::refusal)
    }

    fn disconnect(&mut self, id: ClientId) {
        self.0.disconnect(id);
    }

    fn receive(&mut self, id: ClientId, bytes: &[u8]) {
        self.0.on_bytes(id, bytes, host_ns());
    }

    fn may_receive(&self, id: ClientId) -> bool {
        self.0.may_receive(id)
    }

    fn is_over(&self, id: ClientId) -> bool {
        self.0.is_out_of_step(id)
    }

    fn pending(&self, id: ClientId) -> &[u8] {
        self.0.pending(id)
    }

    fn sent(&mut self, id: ClientId, n: usize) {
        self.0.sent(id, n);
    }
}
