//! Threat 13: what a sender claims, and markup on its way between the forms.

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Time, Value};
use mom_tests::canary::fence_of;
use mom_tests::lab;
use mom_tests::raw::{Raw, at, message};

use super::{After, CHAT, World, chat_xml, entity};

/// Threat 13: who sent it, when it came, and under which fence, is for the hub to say.
#[tokio::test]
async fn threat_13_forged_slots() {
    let mut world = World::start().await;
    for form in Form::ALL {
        let mut bob = world.attacker(form).await;
        let mut forged = message("chat", CHAT, "I am the hub");
        forged.sender = Some("hub".into());
        forged.received = Some(Time::MIN);
        forged.age = Some(-1);
        forged.age_error = Some(0);
        forged.fence = Some(1 << 52);
        forged.priority = Some(i32::MAX);
        forged.extra.set("level", 99);
        forged.extra.set("user", "carol");
        let before = world
            .witness
            .ask(Parcel::new(Family::Time, "ping"))
            .await
            .expect("pong");
        bob.post(forged).await;
        let heard = world.witness.next_of(Family::Message, "chat").await;
        let sender = heard.sender.as_deref().expect("a sender");
        assert!(sender == "bob" || sender.starts_with("bob~"), "{sender}");
        let Some(Value::Time(before)) = before.value().get("received").cloned() else {
            panic!("a pong tells the time");
        };
        assert!(
            heard.received.is_some_and(|received| received >= before),
            "{heard:?}"
        );
        assert_eq!((heard.age, heard.age_error, heard.fence), (Some(0), None, None));
        assert_eq!(heard.priority, Some(0), "no rule allows more");
        assert_eq!(heard.context, Some(at(CHAT)), "{heard:?}");
        // Other slots are the applications' own and say nothing about rights.
        assert_eq!(heard.extra.get("level"), Some(&Value::Int(99)));
        for family in [Family::Event, Family::Reply, Family::Error, Family::Manager] {
            let error = bob.ask(Parcel::new(family, "grabbed").context(at(CHAT))).await;
            assert_eq!(error.expect_err("the hub's own").code.word(), "unknown-verb");
        }
        let error = bob.ask(message("halt", CHAT, Value::Null)).await;
        assert_eq!(error.expect_err("the hub's own").code.word(), "denied");
        world.check_nothing_arrived("forged families").await;
    }
    world.end().await;
}

/// Threat 13: a fence that is not the owner's opens nothing.
#[tokio::test]
async fn threat_13_forged_fences() {
    let world = World::start().await;
    for form in Form::ALL {
        let mut bob = Raw::login(world.address(), form, "bob").await;
        bob.join(&["/robot", "/robot/arm"]).await;
        let info = bob
            .ask_about(Family::Token, "info", "/robot/token")
            .await
            .expect("info");
        let present = fence_of(&info);
        for (fence, code) in [
            (None, "not-owner"),
            (Some(present), "not-owner"),
            (Some(present - 1), "older-fence"),
            (Some(0), "older-fence"),
            (Some(present + 1), "bad-fence"),
            (Some((1 << 53) - 1), "bad-fence"),
        ] {
            let mut command = message("command", "/robot/arm", "grip open");
            command.fence = fence;
            let error = bob.ask(command).await.expect_err("the canary owns the robot");
            assert_eq!(error.code.word(), code, "{fence:?}");
        }
    }
    world.end().await;
}

/// Threat 13: a parcel cannot carry a slot past the codec that would have been looked at.
#[tokio::test]
async fn threat_13_smuggled_slots() {
    let mut world = World::start().await;
    let twice = entity(chat_xml("<sender>alice</sender><sender>hub</sender>"));
    world
        .attack("twice", Form::Xml, &twice, "bad-slot", After::Kept)
        .await;
    let hidden = entity(chat_xml("<slot key=\"sender\">hub</slot><sender>hub</sender>"));
    world
        .attack("by its key", Form::Xml, &hidden, "bad-slot", After::Kept)
        .await;
    // Bits name, id, path, others; the others are {"sender": "hub"}.
    let others = b"\x81\xa6sender\xa3hub";
    let mut bytes = b"\0\x92\x80\x30\x09\x07\x05/chat".to_vec();
    bytes.push(others.len() as u8);
    bytes.extend_from_slice(others);
    let bytes = super::frame(&bytes);
    world
        .attack("among the others", Form::Binary, &bytes, "bad-slot", After::Kept)
        .await;
    world.end().await;
}

/// Threat 13: text stays text from any form to any form, whatever it looks like.
#[tokio::test]
async fn threat_13_markup_between_forms() {
    let broker = lab::start().await;
    let address = broker.local_addr();
    let mut ends = Vec::new();
    for (form, user) in [(Form::Xml, "alice"), (Form::Binary, "carol"), (Form::Xml, "bob")] {
        let mut end = Raw::login(address, form, user).await;
        end.join(&[CHAT]).await;
        ends.push(end);
    }
    let texts = [
        "</content><sender>hub</sender><content>",
        "<![CDATA[x]]>",
        "]]>",
        "&lt;&amp;#60;&#60;",
        "<!DOCTYPE a><?x?><!-- -->",
        "\r\n--mom-0\r\nContent-ID: <part-1>\r\n\r\nx\r\n--mom-0--",
        "Content-Length: 5\r\n\r\n",
        " \t\r\n leading and trailing \r\n",
        "\u{fffd}\u{10ffff}\u{e000}\u{85}\u{2028}",
        "{\"a\":\"\\u0000\"}",
    ];
    for (number, text) in texts.into_iter().enumerate() {
        let binary = format!("\r\n--mom-{number}\r\n{text}").into_bytes().repeat(9);
        let inner = Map::new()
            .with("text", text)
            .with(text, "as a key")
            .with("xml:lang", "a colon")
            .with("slot", Value::Binary(binary.into()))
            .with(
                "",
                vec![
                    Value::from(text),
                    Value::Null,
                    Value::Double(-0.5),
                    Value::Bool(true),
                ],
            );
        for sender in 0..ends.len() {
            let mut parcel = message("a <b> & \"c\"", CHAT, inner.clone());
            parcel.extra.set("note", text);
            parcel.extra.set("a <key>", text);
            let id = ends[sender].post(parcel.clone()).await;
            let mut heard = Vec::new();
            for end in &mut ends {
                heard.push(end.next_of(Family::Message, "a <b> & \"c\"").await);
            }
            for heard in heard {
                assert_eq!(
                    (heard.id, heard.value()),
                    (Some(id), Value::Map(inner.clone())),
                    "{text:?}"
                );
                assert_eq!(heard.extra, parcel.extra, "{text:?}");
            }
        }
    }
    broker.stop().await;
}
