import assert from "node:assert/strict";
import test from "node:test";
import { Double, Time, decode, encode } from "../dist/test/internals.js";
import { jsonForm } from "./jsonform.mjs";

const { read, write } = jsonForm({ Double, Time });

test("parcels of dialogues pass through the codec unchanged", () => {
  const lines = [
    `{"family":"login","name":"login","id":1,"content":{"name":"alice","password":"alice"}}`,
    `{"family":"message","name":"settings","timestamp":"2026-11-21T10:00:00.000123Z","context":"/camera/x","content":{"key":{"$binary":"AQIDBA=="},"since":{"$time":"2026-11-21T10:00:00.000000Z"},"pixels":{"$int":"9223372036854775807"},"zoom":1.0,"none":-0.0,"huge":1e+300,"2":1,"1":[null,true,{"$map":{"$int":"x"}},{}]}}`,
    `{"family":"event","name":"x","id":300,"reference":2,"sender":"hub","address":["bob"],"priority":-5,"context":"/a","expires":250,"delivery":"latest","fence":7,"received":"1969-12-31T23:59:59.999999Z","age":-1,"age-error":9,"echo":false,"receipt":true,"history":true,"$odd":1.5}`,
  ];
  for (const line of lines) assert.equal(write(decode(encode(read(line)).subarray(5), true)), line);
});
