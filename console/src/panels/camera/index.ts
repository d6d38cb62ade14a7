import { define } from "../../element.svelte.js";
import Camera from "./Camera.svelte";
import css from "./camera.css?inline";
import lines from "./lines.css?inline";

define("mom-camera", Camera, lines + css, ["path", "device", "poses", "bare", "small", "fresh", "rate", "still"]);
