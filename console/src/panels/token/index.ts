import { define } from "../../element.svelte.js";
import Token from "./Token.svelte";
import css from "./token.css?inline";

define("mom-token", Token, css, ["path"]);
