use std::io::Write as _;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use flate2::write::ZlibEncoder;
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{Code, Compression, Family, Limit, Limits, Parcel, STREAM_MARK, Value};
use proptest::prelude::*;
use tokio::io::AsyncWriteExt as _;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

use super::Unpacker;
use crate::carrier::Carrier;
use crate::tcp::begin;
use crate::{NetError, Privacy, Transceiver, socket};

const PATIENCE: Duration = Duration::from_secs(60);
const STREAMS: [Compression; 2] = [Compression::StreamZstd, Compression::StreamDeflate];

/// What another's tool makes of bytes, with a flush after each of them.
fn compressed(way: Compression, parts: &[&[u8]]) -> Vec<u8> {
    match way {
        Compression::StreamDeflate => {
            let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::best());
            for part in parts {
                encoder.write_all(part).expect("memory");
                encoder.flush().expect("memory");
            }
            encoder.finish().expect("memory")
        }
        _ => zstd_of(17, parts),
    }
}

fn zstd_of(window_log: u32, parts: &[&[u8]]) -> Vec<u8> {
    let mut encoder = zstd::stream::write::Encoder::new(Vec::new(), 3).expect("memory");
    encoder.window_log(window_log).expect("a window");
    for part in parts {
        encoder.write_all(part).expect("memory");
        encoder.flush().expect("memory");
    }
    encoder.finish().expect("memory")
}

fn noise(bytes: usize) -> Vec<u8> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()[3]
    };
    (0..bytes).map(|_| next()).collect()
}

/// What a reader gets of bytes that arrive in these pieces, and the most that it got at once.
fn opened(way: Compression, form: Form, pieces: &[&[u8]]) -> Result<(Vec<u8>, usize), mom_proto::WireError> {
    let mut unpacker = Unpacker::new(way, form);
    let (mut all, mut most, mut front) = (Vec::new(), 0, BytesMut::new());
    for piece in pieces {
        if unpacker.is_open() {
            unpacker.arrive(piece);
        } else {
            front.extend_from_slice(piece);
            if !unpacker.begin(&mut front)? || !unpacker.is_open() {
                continue;
            }
        }
        loop {
            most = most.max(front.len());
            all.extend_from_slice(&front.split());
            if !unpacker.has_more() {
                break;
            }
            unpacker.fill(&mut front)?;
        }
    }
    all.extend_from_slice(&front);
    Ok((all, most))
}

proptest! {
    /// However a stream was flushed and is cut on its way, behind whatever blanks.
    #[test]
    fn a_stream_is_opened_wherever_it_is_cut(
        parts in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..300), 1..8),
        cuts in proptest::collection::vec(any::<prop::sample::Index>(), 0..12),
        blanks in 0..3_usize,
    ) {
        for way in STREAMS {
            for form in Form::ALL {
                let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
                let (front, plain) = match form.is_binary() {
                    true => (STREAM_MARK.to_vec(), parts.concat()),
                    false => (vec![b'\n'; blanks], [&vec![b'\n'; blanks][..], &parts.concat()].concat()),
                };
                // Twice: one stream may follow another.
                let whole = [front, compressed(way, &parts), compressed(way, &parts)].concat();
                let mut places: Vec<usize> = cuts.iter().map(|cut| cut.index(whole.len())).collect();
                places.extend([0, whole.len()]);
                places.sort_unstable();
                let pieces: Vec<&[u8]> = places.windows(2).map(|pair| &whole[pair[0]..pair[1]]).collect();
                let (all, _) = opened(way, form, &pieces).expect("a stream");
                prop_assert_eq!(all, [plain, parts.concat()].concat());
            }
        }
    }

    /// Hostile bytes are refused or opened, and never more than a step at once.
    #[test]
    fn whatever_follows_the_beginning_nothing_panics(
        rest in proptest::collection::vec(any::<u8>(), 0..600),
        change in any::<prop::sample::Index>(),
        to in any::<u8>(),
    ) {
        for way in STREAMS {
            let mut broken = compressed(way, &[b"{\"family\":\"time\"}\n", &noise(200)]);
            let at = change.index(broken.len());
            broken[at] = to;
            broken.extend_from_slice(&rest);
            if let Ok((_, most)) = opened(way, Form::Json, &[&broken]) {
                prop_assert!(most <= 64 * 1024);
            }
        }
    }
}

#[test]
fn a_bomb_is_opened_a_step_at_a_time() {
    let zeros = vec![0; 32 * 1024 * 1024];
    for way in STREAMS {
        let bomb = compressed(way, &[&zeros]);
        assert!(bomb.len() * 500 < zeros.len());
        let (all, most) = opened(way, Form::Json, &[&bomb]).expect("a stream");
        assert!(all == zeros && most <= 64 * 1024, "{way}: {most}");
    }
}

#[test]
fn what_is_no_stream_or_needs_more_memory_is_refused() {
    let text = noise(300 * 1024);
    let zlib = compressed(Compression::StreamDeflate, &[&text]);
    let mut cut = zlib.clone();
    cut[200..].fill(0xff);
    for (way, bytes, why) in [
        (
            Compression::StreamZstd,
            zstd_of(20, &[&text]),
            "window is 128 KiB",
        ),
        (
            Compression::StreamZstd,
            [&[0x28, 0xb5, 0x2f, 0xfd][..], &[0xff; 60]].concat(),
            "cannot be opened",
        ),
        (Compression::StreamDeflate, cut, "stream-deflate cannot be opened"),
    ] {
        let error = opened(way, Form::Xml, &[&bytes]).expect_err("refused");
        assert_eq!(error.code, Code::BAD_FRAME);
        assert!(error.text.contains(why), "{error}");
    }
    // What begins as text is left to its form.
    for plain in [&b"{\"family\""[..], b"x=", b"Content-", b"\n", b"(x"] {
        for way in STREAMS {
            assert_eq!(opened(way, Form::Json, &[plain]).expect("passed on").0, plain);
        }
    }
}

/// Two ends of one TCP connection.
async fn ends(form: Form) -> (Transceiver, Transceiver) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    let (here, there) = tokio::join!(TcpStream::connect(address), listener.accept());
    let limits = Limits {
        parcel: Limit::Unlimited,
        ..Limits::default()
    };
    let mut both = Vec::new();
    for stream in [here.expect("a connection"), there.expect("a connection").0] {
        let end = begin(
            socket::plain(Carrier::Tcp(stream)),
            Privacy::Plain,
            form,
            Decoder::new(form, &limits),
            BytesMut::new(),
        );
        both.push(end.await.expect("it begins"));
    }
    let there = both.pop().expect("the other");
    (both.pop().expect("the one"), there)
}

fn say(id: u64, content: impl Into<Value>) -> Parcel {
    Parcel::new(Family::Message, "say").id(id).content(content)
}

async fn next(end: &mut Transceiver) -> Parcel {
    let next = timeout(PATIENCE, end.reader.next()).await.expect("it comes");
    match next.expect("a link").expect("more") {
        Frame::Parcel(parcel) => *parcel,
        Frame::Malformed { error, .. } => panic!("{error}"),
    }
}

/// Parcels come as they were said, the first ones plain; the later ones, which are far more than the network holds, take a tenth of
/// the bytes.
#[tokio::test]
async fn parcels_go_through_a_stream_that_begins_between_them() {
    for way in STREAMS {
        for form in Form::ALL {
            let (mut here, mut there) = ends(form).await;
            there.reader.take_compressed(way);
            here.writer.send(say(1, "plain")).await.expect("a link");
            assert_eq!(next(&mut there).await.id, Some(1));
            let before = here.writer.link().expect("TCP").acknowledged;
            here.writer.compress(way);
            here.writer.at_boundary().expect("memory");
            let text = "MoveL [[512.0,0.0,712.0],[1,0,0,0]], vslow, fine, tool0;\n".repeat(2000);
            let writing = async {
                for id in 2..40 {
                    here.writer.send(say(id, text.as_str())).await.expect("a link");
                }
                // Nothing waits in the compressor for what comes later.
                here.writer
                    .send(say(40, Bytes::from(noise(3_000_000))))
                    .await
                    .expect("a link");
                here.writer.send(say(41, "last")).await.expect("a link");
            };
            let reading = async {
                for id in 2..=41 {
                    let parcel = next(&mut there).await;
                    assert_eq!(parcel.id, Some(id), "{way} {form:?}");
                    match id {
                        40 => assert_eq!(parcel.value().as_binary().map(Bytes::len), Some(3_000_000)),
                        41 => assert_eq!(parcel.value(), Value::from("last")),
                        _ => assert_eq!(parcel.value(), Value::from(text.as_str())),
                    }
                }
            };
            timeout(PATIENCE, async { tokio::join!(writing, reading) })
                .await
                .expect("it ends");
            // Acknowledged counts as if it had gone plain, but for what was not acknowledged yet.
            let link = here.writer.link().expect("TCP");
            let told = link.acknowledged - before;
            assert!(told > 38 * text.len() as u64, "{told}");
            here.writer.finish();
            let end = timeout(PATIENCE, there.reader.next()).await.expect("it ends");
            assert!(matches!(end, Ok(None)), "{end:?}");
        }
    }
}

/// Without an agreement a stream is what it was before: no parcel.
#[tokio::test]
async fn a_stream_that_was_not_agreed_on_is_refused() {
    for form in Form::ALL {
        let (mut here, mut there) = ends(form).await;
        here.writer.compress(Compression::StreamZstd);
        here.writer.at_boundary().expect("memory");
        here.writer
            .send(say(1, "x".repeat(3_000_000).as_str()))
            .await
            .expect("a link");
        here.writer
            .send(say(2, Bytes::from(noise(100_000))))
            .await
            .expect("a link");
        here.writer.finish();
        let told = timeout(PATIENCE, there.reader.next()).await.expect("it ends");
        match told {
            Err(NetError::Wire(error)) => assert_eq!(error.code, Code::BAD_FRAME, "{error}"),
            Ok(Some(Frame::Malformed { .. })) | Err(NetError::Io(_)) => {}
            other => panic!("{form:?}: {other:?}"),
        }
    }
}

/// A link that ends in the middle of a parcel has ended so, compressed or not.
#[tokio::test]
async fn an_end_in_the_middle_of_a_parcel_is_one() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    let (here, there) = tokio::join!(TcpStream::connect(address), listener.accept());
    let (mut here, there) = (here.expect("a connection"), there.expect("a connection").0);
    let limits = Limits::default();
    let end = begin(
        socket::plain(Carrier::Tcp(there)),
        Privacy::Plain,
        Form::Json,
        Decoder::new(Form::Json, &limits),
        BytesMut::new(),
    );
    let mut end = end.await.expect("it begins");
    end.reader.take_compressed(Compression::StreamDeflate);
    let half = compressed(Compression::StreamDeflate, &[b"{\"family\":\"message\","]);
    here.write_all(&half).await.expect("a link");
    here.shutdown().await.expect("a link");
    let told = timeout(PATIENCE, end.reader.next()).await.expect("it ends");
    assert!(
        matches!(&told, Err(NetError::Io(error)) if error.kind() == std::io::ErrorKind::UnexpectedEof),
        "{told:?}"
    );
}

/// A peer that sends blanks one by one is not looked at anew from the first one each time.
#[test]
fn many_blanks_are_no_beginning() {
    for way in STREAMS {
        let many = [&[b'\r'; 5][..], &compressed(way, &[b"{}\n"])].concat();
        assert_eq!(
            opened(way, Form::Json, &[&many]).expect("passed on").0,
            many,
            "{way}"
        );
    }
}

/// What came whole before a fault is handed on first.
#[test]
fn what_comes_before_a_fault_is_opened() {
    for way in STREAMS {
        let good = compressed(way, &[b"{\"family\":\"time\"}\n"]);
        let bytes = [&good[..], &[0x78, 0x9c, 0xff, 0xff, 0xff, 0xff]].concat();
        let mut unpacker = Unpacker::new(way, Form::Json);
        let mut front = BytesMut::from(&bytes[..]);
        assert!(unpacker.begin(&mut front).expect("a stream"));
        assert_eq!(&front[..], b"{\"family\":\"time\"}\n", "{way}");
        assert!(unpacker.has_more(), "{way}: the fault is to be told");
        let error = unpacker.fill(&mut front).expect_err("it is broken");
        assert_eq!(error.code, Code::BAD_FRAME, "{way}");
    }
}

/// Streams that hold next to nothing, one after another, are work: others have their turn between some of them.
#[test]
fn streams_of_nothing_are_opened_a_few_at_a_time() {
    for way in STREAMS {
        let many = compressed(way, &[b"\n"]).repeat(1000);
        let mut unpacker = Unpacker::new(way, Form::Json);
        let mut front = BytesMut::from(&many[..]);
        assert!(unpacker.begin(&mut front).expect("a stream"));
        let mut turns = 0;
        while unpacker.has_more() {
            assert!(unpacker.is_tired(), "{way}");
            let before = front.len();
            unpacker.fill(&mut front).expect("a stream");
            assert!(front.len() - before <= 16, "{way}: {}", front.len() - before);
            turns += 1;
        }
        assert!(front.len() == 1000 && turns >= 60, "{way}: {turns}");
    }
}

/// A large message is compressed a turn at a time, so that others served in this thread wait for one of them at most.
#[tokio::test]
async fn whoever_compresses_much_gives_way_between_turns() {
    for way in STREAMS {
        let (here, mut there) = ends(Form::Json).await;
        there.reader.take_compressed(way);
        here.writer.compress(way);
        here.writer.at_boundary().expect("memory");
        // Nothing of it fills the network.
        let large = say(1, "0".repeat(4_000_000).as_str());
        let mut queue = std::collections::VecDeque::from([here
            .writer
            .prepare(std::sync::Arc::new(large))
            .expect("a form")]);
        let reading = tokio::spawn(async move { next(&mut there).await.id });
        let mut turns = 0;
        while here.writer.try_write(&mut queue).expect("a link") == crate::Progress::Blocked {
            turns += 1;
            here.writer.ready().await.expect("a link");
        }
        assert!(turns >= 4_000_000 / 16_384, "{way}: {turns}");
        assert_eq!(
            timeout(PATIENCE, reading)
                .await
                .expect("it comes")
                .expect("it is read"),
            Some(1)
        );
    }
}
