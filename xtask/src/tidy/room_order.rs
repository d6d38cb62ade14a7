//! The rooms of each large package from the top down, which [`rooms`](super::rooms) holds it to.

/// A room may use itself and those after it. The files that cargo starts from, such as `lib.rs`, are no rooms and may use all; so what they
/// define themselves is above all rooms, but for constants and names of types. What only tests compile is free.
pub(super) const ROOMS: &[(&str, &str)] = &[
    (
        "mom-proto",
        "card codec binary json xml frame slots text_form checksum fence trace loss clock_offset parcel content serde_value packed \
         msgpack pattern path thinning names verb limits error value codes event family delivery gcra stamp challenge \
         compression context_kind fingerprint visible",
    ),
    (
        "mom-managers",
        "builtin chain closed first_come level_or_lease moderated open queue quota roles schedule self_managed zones calendar \
         bucket given held params who registry manager verdict question",
    ),
    (
        "mom-hub",
        "hub verbs contexts stops ownership asking world messages tree token heard content values peer_id",
    ),
    (
        "mom-broker",
        "program reload broker inquiry web connection traffic",
    ),
    (
        "mom-login",
        "subjects throttle places resume book user settings jwt key content hashing password link error",
    ),
    (
        "mom-journal",
        "tap record audit fold log_writer config_file kept_files error",
    ),
    (
        "mom-config",
        "review explain check managers locate login journal replace variant load users schema shape faults config source tls \
         web listen error",
    ),
    (
        "mom-client",
        "control contexts link peer device wire said words error refusal",
    ),
    (
        "mom-net",
        "line tcp local transceiver queue flow part reader writer compressed socket websocket tunnel dial http carrier tls turn \
         options proxy takes outgoing address spare secret_id link error",
    ),
    (
        "mom",
        "commands doctor top complete cli devices connect global input output failure",
    ),
    (
        "mom-device",
        "obey back contexts run clock outlet server estop fresh refusal pull queue declared carded call reading machine command script words rest error",
    ),
    (
        "mom-wheels",
        "traced simulated eye pilot parameters wall watchdog driver",
    ),
    (
        "mom-arm",
        "program peer zone_watch zone_keeper rapid status arm state script machine action controller contact blocks upright_box zones \
         path jog workspace reach motion pose",
    ),
    (
        "mom-camera",
        "program peer server shot calibration predicted trail renderer draw overlay view robot solid scene pan geometry source encode \
         settings error owner",
    ),
    (
        "mom-model",
        "program verb peer plan server look objects object owners",
    ),
    (
        "mom-servo",
        "program verb peer control aim plan memory eyes track motion task",
    ),
    (
        "mom-mcp",
        "program server tools drive script progress sight assistant device answer stdio id_of",
    ),
    (
        "mom-linuxbot",
        "program listen hearing page access eye login refusals robot glance status",
    ),
    (
        "mom-base-station",
        "program edit play station script log circuit fleet",
    ),
    (
        "mom-gateway",
        "program verb peer crew editor robot site station unit",
    ),
    (
        "mom-simulacrum",
        "program peer generator unit action playing teller wheels link values",
    ),
    (
        "mom-rsp",
        "typed middle robot sound handshake packet traffic seal sequence number layout fragment header refused",
    ),
    (
        "mom-rsp-model",
        "verb build generate read export faults check xmi canonical quantities keys model text fault",
    ),
    (
        "xtask",
        "advisories ci experiments instructions long mutants peers measuring needs shuttle simulate test clients console javascript npm \
         counts verdict tidy command node",
    ),
];
