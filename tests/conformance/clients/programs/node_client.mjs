// What a user of node-mavlink writes: `node node_client.mjs MODULES PORT` prints what it saw as one JSON object.

import { createSocket } from 'node:dgram'
import { createRequire } from 'node:module'
import { PassThrough } from 'node:stream'

const [modules, port] = process.argv.slice(2)
const mavlink = createRequire(modules)('node-mavlink')
const { MavLinkPacketSplitter, MavLinkPacketParser, MavLinkProtocolV2, minimal, common } = mavlink

const registry = { ...minimal.REGISTRY, ...common.REGISTRY }
const input = new PassThrough()
const reader = input.pipe(new MavLinkPacketSplitter()).pipe(new MavLinkPacketParser())
const socket = createSocket('udp4')
const protocol = new MavLinkProtocolV2(255, 190)
const facts = { parameters: {}, types: [] }
const types = new Set()
let sequence = 0
let asked = false
let vehicle

const send = (message) => socket.send(protocol.serialize(message, sequence++ % 256), vehicle.port, vehicle.address)

function done() {
  socket.close()
  facts.types = [...types].sort()
  console.log(JSON.stringify(facts))
  process.exit(0)
}

reader.on('data', (packet) => {
  const kind = registry[packet.header.msgid]
  if (!kind) return
  const message = packet.protocol.data(packet.payload, kind)
  types.add(kind.MSG_NAME)
  if (message instanceof minimal.Heartbeat && !asked) {
    asked = true
    facts.system = packet.header.sysid
    facts.autopilot = message.autopilot
    const request = new common.ParamRequestList()
    request.targetSystem = facts.system
    request.targetComponent = 1
    send(new minimal.Heartbeat())
    send(request)
  }
  if (message instanceof common.ParamValue) {
    facts.parameters[message.paramId] = message.paramValue
    if (Object.keys(facts.parameters).length !== message.paramCount) return
    const arm = new common.ComponentArmDisarmCommand()
    arm.targetSystem = facts.system
    arm.targetComponent = 1
    arm.arm = 1
    send(arm)
  }
  if (message instanceof common.CommandAck) {
    facts.result = message.result
    setTimeout(done, 500)
  }
})

setTimeout(() => {
  console.error('not all answers came', facts)
  process.exit(1)
}, 30000)
socket.on('message', (datagram, sender) => {
  vehicle = sender
  input.write(datagram)
})
socket.bind(Number(port), '127.0.0.1')
