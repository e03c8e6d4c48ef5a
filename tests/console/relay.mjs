// Stands between the browser and the service, and can be cut as a network can.

import net from "node:net";

export class Relay {
  /** @param {number} port of the service on this machine */
  constructor(port) {
    this.isCut = false;
    this.sockets = new Set();
    this.bytes = 0;
    this.server = net.createServer((socket) => {
      if (this.isCut) { socket.destroy(); return; }
      const onward = net.connect(port, "127.0.0.1");
      for (const [from, to] of [[socket, onward], [onward, socket]]) {
        this.sockets.add(from);
        from.on("error", () => to.destroy());
        from.on("close", () => { this.sockets.delete(from); to.destroy(); });
        from.pipe(to);
      }
      onward.on("data", (part) => { this.bytes += part.length; });
    });
  }

  /** Starts to listen, and returns the address for the browser. */
  async listen() {
    await new Promise((resolve) => this.server.listen(0, "127.0.0.1", resolve));
    return "http://127.0.0.1:" + this.server.address().port;
  }

  cut() {
    this.isCut = true;
    for (const socket of this.sockets) socket.destroy();
  }

  mend() {
    this.isCut = false;
  }

  close() {
    this.cut();
    this.server.close();
  }
}
