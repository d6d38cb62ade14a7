import { define } from "../../element.svelte.js";
import "../camera/index.js";
import lines from "../camera/lines.css?inline";
import "../cursor/index.js";
import Cameras from "./Cameras.svelte";
import css from "./cameras.css?inline";

define("mom-cameras", Cameras, lines + css, ["cursorless", "device", "poses", "without"]);
