import { local } from "./error.js";

const PEM = /-----BEGIN PRIVATE KEY-----([A-Za-z0-9+/=\s]+)-----END PRIVATE KEY-----/;
const ED25519 = { name: "Ed25519" };

/** What Web Crypto needs, or the reason why a key cannot be used here. */
function subtle(): SubtleCrypto {
  const found = globalThis.crypto?.subtle as SubtleCrypto | undefined;
  if (!found) {
    throw local(
      "bad-login",
      "a key needs Web Crypto, which browsers give to pages from https:// and localhost only: serve the page so, or use a password",
    );
  }
  return found;
}

async function supported<T>(asked: Promise<T>): Promise<T> {
  try {
    return await asked;
  } catch (error) {
    if (error instanceof DOMException && error.name === "NotSupportedError") {
      throw local("bad-login", "this browser's Web Crypto has no Ed25519 (Chrome 137, Firefox 129, Safari 17 do): update it, or use a password");
    }
    throw error;
  }
}

/** A private key (Ed25519). It never leaves this machine; the hub knows the public one from its users file. */
export class Key {
  private constructor(readonly key: CryptoKey) {}

  /** Reads PKCS#8 in PEM, as `mom keygen` writes it. The key cannot be read out of what this gives. */
  static async fromPem(pem: string): Promise<Key> {
    const base64 = PEM.exec(pem)?.[1];
    if (!base64) throw local("bad-encoding", "this is not a private key in PEM (-----BEGIN PRIVATE KEY-----)");
    const bytes = Uint8Array.from(atob(base64.replace(/\s/g, "")), (letter) => letter.charCodeAt(0));
    const crypto = subtle();
    // A key with its public half beside it is of another version of PKCS#8, which browsers refuse: the private half is enough.
    const seed = bytes.subarray(0, 48);
    const plain = Uint8Array.of(0x30, 46, 2, 1, 0, ...seed.subarray(5));
    try {
      return new Key(await supported(crypto.importKey("pkcs8", plain, ED25519, false, ["sign"])));
    } catch (error) {
      if (error instanceof DOMException && error.name === "DataError") throw local("bad-encoding", "this is not an Ed25519 private key");
      throw error;
    }
  }

  /** A key that Web Crypto has already, for example one kept in IndexedDB. */
  static of(key: CryptoKey): Key {
    return new Key(key);
  }

  /** @internal */
  async sign(message: Uint8Array): Promise<Uint8Array> {
    return new Uint8Array(await supported(subtle().sign(ED25519, this.key, message as Uint8Array<ArrayBuffer>)));
  }
}
