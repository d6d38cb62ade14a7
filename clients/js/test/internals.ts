// What the tests look into.
export * from "../src/index.js";
export { encode, decode, PREFACE } from "../src/binary.js";
export { Frames, chunk } from "../src/frames.js";
export { Reader, Writer } from "../src/bytes.js";
export { Unpacker, pack } from "../src/msgpack.js";
export { Ledger } from "../src/ledger.js";
export { Outbox } from "../src/outbox.js";
export { Queue } from "../src/queue.js";
export { sha256, hmac } from "../src/sha256.js";
export { doorsOf, shown } from "../src/address.js";
export { Attempts } from "../src/connector.js";
export { WORDS } from "../src/words.js";
export { Wire } from "../src/wire.js";
