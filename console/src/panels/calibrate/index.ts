import { define } from "../../element.svelte.js";
import Calibrate from "./Calibrate.svelte";
import css from "./calibrate.css?inline";

define("mom-calibrate", Calibrate, css, ["agent", "device", "camera"]);
