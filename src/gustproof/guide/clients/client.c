/* Hold the paper's vehicle level: cc client.c -lm -o client; gustproof fly calm --controller "exec: ./client" */
#include <arpa/inet.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
static int udp;
static void pack(uint8_t id, uint8_t extra, const void *payload, uint8_t size) { /* from system 1, component 191 */
  static uint8_t sequence, frame[64]; uint16_t crc = 0xFFFF;
  memcpy(frame, (uint8_t[10]){0xFD, size, 0, 0, sequence++, 1, 191, id}, 10), memcpy(frame + 10, payload, size);
  for (int i = 1; i <= size + 10; i++) {
    uint8_t x = (uint8_t)(crc ^ (i < size + 10 ? frame[i] : extra)), y = (uint8_t)(x ^ x << 4);
    crc = (uint16_t)(crc >> 8 ^ y << 8 ^ y << 3 ^ y >> 4);
  }
  memcpy(frame + size + 10, &crc, 2), send(udp, frame, size + 12u, 0);
}
int main(void) {
  const float stiffness[] = {2.2f, 1.8f, .9f}, damping[] = {1.2f, 1.f, .5f}; /* [N m/rad], [N m s/rad] */
  float limit[3] = {0}, angle[3] = {0}, rate; /* limit: the torque [N m] of 1.0, a parameter of the vehicle */
  struct { uint64_t stamp; float u[8]; uint8_t to[4]; } reply = {0, {0, 0, 0, NAN}, {0, 1, 1}}; /* NaN: hold height */
  struct { float p[7]; uint16_t command; uint8_t to[4]; } arm = {{1}, 400, {1, 1}}, offboard = {{1, 6}, 176, {1, 1}};
  uint8_t ask[21] = "\xff\xff\1\1GP_TRQ_MAX_", heartbeat[] = {0, 0, 0, 0, 18, 8, 0, 4, 3}, in[300] = {0}, *p = in + 10;
  uint16_t port = htons((uint16_t)atoi(strchr(getenv("GUSTPROOF_ADDRESS"), ':') + 1));
  struct sockaddr_in vehicle = {.sin_family = AF_INET, .sin_port = port, .sin_addr = {htonl(INADDR_LOOPBACK)}};
  connect(udp = socket(AF_INET, SOCK_DGRAM, 0), (struct sockaddr *)&vehicle, sizeof vehicle);
  for (time_t beat = 0; in[7] || !reply.stamp || p[6] & 128; beat = time(NULL)) { /* until HEARTBEAT is disarmed */
    if (time(NULL) != beat) pack(0, 50, heartbeat, 9);
    memset(in, 0, 300), recv(udp, in, 280, 0), p[in[1]] = p[in[1] + 1] = 0; /* zeros at the end are not sent */
    if (in[7] == 22) memcpy(limit + (p[19] == 'P') + 2 * (p[19] == 'Y'), p, 4); /* PARAM_VALUE */
    if (in[7] != 105) continue;
    uint64_t before = reply.stamp; memcpy(&reply.stamp, p, 8); /* HIGHRES_IMU */
    for (int i = 0; i < 3; i++) { /* a sample that is sent again adds no angle and gets the same answer */
      if (limit[i] == 0) ask[15] = (uint8_t)"RPY"[i], pack(20, 214, ask, 20); /* PARAM_REQUEST_READ */
      memcpy(&rate, p + 20 + 4 * i, 4), angle[i] += 1e-6f * (float)(reply.stamp - before) * rate;
      reply.u[i] = fmaxf(-1, fminf(1, -(stiffness[i] * angle[i] + damping[i] * rate) / limit[i]));
    }
    if (limit[0] * limit[1] * limit[2] > 0) pack(139, 168, &reply, 43); /* SET_ACTUATOR_CONTROL_TARGET */
    if (reply.stamp == 0) pack(76, 152, &arm, 33), pack(76, 152, &offboard, 33); /* COMMAND_LONG */
  }
}
