//! Hubs behind each of their doors.

use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use mom_benches::{Driver, Error, Hub, Process, RelayDriver};
use mom_proto::codec::Form;
use mom_tests::tls;

use crate::brokers::{Kind, Programs};
use crate::driver::{MqttDriver, NatsDriver};
use crate::gateway::Passage;

/// A hub with the gateway to its door.
pub struct DoorHub {
    /// The hub, spoken to through the gateway.
    pub hub: Hub,
    /// Where it is and by which door.
    pub passage: Passage,
    /// The hub itself.
    pub address: SocketAddr,
    // It ends with this.
    _gateway: Process,
}

impl Programs {
    /// Starts a hub with this door, and a gateway to it.
    ///
    /// # Errors
    /// A program that is not there or does not start, or a hub that has no such door.
    pub fn start_door(&self, kind: Kind, passage: Passage, gateway: &Path) -> Result<DoorHub, Error> {
        let listener = TcpListener::bind(("127.0.0.1", 0)).and_then(|listener| listener.local_addr());
        let address = listener.map_err(Error::io("a free port"))?;
        let certificate = tls::make(self.scratch(), "hub");
        let command = self.door_command(
            kind,
            passage,
            address,
            [&certificate.certificate, &certificate.key],
        )?;
        let name = format!("{} {}", kind.name(), passage.name());
        let log = self.scratch().join(format!("{name}.log"));
        let connects = |address: &str| std::net::TcpStream::connect(address).is_ok();
        let process = Process::start_at(command, &address.to_string(), &log, connects)?;
        let mut command = Command::new(gateway);
        command.args([
            "--to",
            &address.to_string(),
            "--door",
            passage.name(),
            "--certificate",
        ]);
        command.arg(&certificate.certificate);
        match kind {
            Kind::Mom => command.args(["--path", "/mom", "--protocol", "mom.bin.v1"]),
            Kind::Mosquitto => command.args(["--protocol", "mqtt"]),
            _ => &mut command,
        };
        let gateway = Process::start(command)?;
        let (door, address) = (address, gateway.address().to_owned());
        let driver: Box<dyn Driver> = match kind {
            Kind::Mom => Hub::broker(&address, Form::Binary)?.driver,
            Kind::Nats => Box::new(NatsDriver::new(&address)),
            Kind::Mosquitto => Box::new(MqttDriver::new(&address)),
            _ => Box::new(RelayDriver::new(&address)),
        };
        let hub = Hub {
            name,
            driver,
            process: Some(Arc::new(process)),
        };
        Ok(DoorHub {
            hub,
            passage,
            address: door,
            _gateway: gateway,
        })
    }

    /// What clients know the certificate of the doors by.
    ///
    /// # Errors
    /// No certificate yet.
    pub fn pin(&self) -> Result<String, Error> {
        let files = tls::make(self.scratch(), "hub");
        tls::fingerprint(&files).ok_or_else(|| Error::Unexpected("no certificate".to_owned()))
    }

    fn door_command(
        &self,
        kind: Kind,
        passage: Passage,
        address: SocketAddr,
        certificate: [&Path; 2],
    ) -> Result<Command, Error> {
        let [cert, key] = certificate.map(Path::display);
        let port = address.port();
        let mut command = Command::new(self.program(kind)?);
        match kind {
            Kind::RawRelay => {
                command.args(["--listen", &address.to_string(), "--raw"]);
            }
            Kind::Mom => {
                let config =
                    self.broker_config()? + &format!("\n[tls]\ncertificate = \"{cert}\"\nkey = \"{key}\"\n");
                command
                    .arg("--config")
                    .arg(self.broker_file("doors.toml", &config)?);
                command.args(["--listen", &address.to_string()]);
            }
            Kind::Nats => {
                let tls = format!("tls {{ cert_file: \"{cert}\", key_file: \"{key}\" }}");
                let first =
                    format!("tls {{ cert_file: \"{cert}\", key_file: \"{key}\", handshake_first: true }}");
                let text = match passage {
                    Passage::Tcp => format!("host: 127.0.0.1\nport: {port}\n"),
                    Passage::Tls => format!("host: 127.0.0.1\nport: {port}\n{first}\n"),
                    Passage::Ws => {
                        format!("port: -1\nwebsocket {{ host: 127.0.0.1, port: {port}, no_tls: true }}\n")
                    }
                    Passage::Wss => {
                        format!("port: -1\nwebsocket {{ host: 127.0.0.1, port: {port}\n{tls}\n}}\n")
                    }
                };
                command.arg("-c").arg(self.file("nats-doors.conf", &text)?);
            }
            Kind::Mosquitto => {
                let mut text = format!("listener {port} 127.0.0.1\n");
                if passage.is_websocket() {
                    // Version 2.0 does not start with listeners for WebSocket only.
                    let socket = self.scratch().join("mosquitto.sock");
                    text = format!("listener 0 {}\n{text}protocol websockets\n", socket.display());
                }
                if passage.has_tls() {
                    text += &format!("certfile {cert}\nkeyfile {key}\n");
                }
                text += "allow_anonymous true\npersistence false\nset_tcp_nodelay true\nmax_queued_messages 0\nlog_dest none\nuser root\n";
                command.arg("-c").arg(self.file("mosquitto-doors.conf", &text)?);
            }
            _ => {
                return Err(Error::Unexpected(format!(
                    "{} is not measured by its doors",
                    kind.name()
                )));
            }
        }
        Ok(command)
    }
}
