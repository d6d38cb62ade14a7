//! Any bytes, to the codec and to both ends; the same functions are the fuzz targets.

mod any_bytes;

use proptest::prelude::*;

/// Datagrams that look like some: types that exist, and few bits.
fn likely() -> impl Strategy<Value = Vec<u8>> {
    let kind = prop_oneof![0..5_u8, 0x80..0x86_u8];
    let one = (
        kind,
        any::<u8>(),
        proptest::collection::vec(prop_oneof![3 => 0..3_u8, 1 => any::<u8>()], 0..40),
    );
    let datagram = one.prop_map(|(kind, how, body)| {
        let mut bytes = vec![20 + body.len() as u8, how | 1];
        bytes.extend_from_slice(&[1, 0, 0, 0, kind]);
        bytes.extend_from_slice(&[0; 15]);
        bytes.extend_from_slice(&body);
        bytes
    });
    proptest::collection::vec(datagram, 0..60).prop_map(|datagrams| datagrams.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_codec_takes_any_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
        any_bytes::any_packet(&bytes);
    }

    #[test]
    fn the_codec_takes_any_map(map in any::<[u8; 2]>(), payload in proptest::collection::vec(0..4_u8, 0..40)) {
        any_bytes::any_packet(&[&map[..], &payload].concat());
    }

    #[test]
    fn a_robot_takes_any_datagrams(bytes in prop_oneof![likely(), proptest::collection::vec(any::<u8>(), 0..600)]) {
        any_bytes::any_datagram(&bytes);
    }

    #[test]
    fn a_middle_takes_any_datagrams(bytes in prop_oneof![likely(), proptest::collection::vec(any::<u8>(), 0..600)]) {
        any_bytes::any_uplink(&bytes);
    }
}
