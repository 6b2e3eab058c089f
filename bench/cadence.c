/* The yardstick: a frame every 50 ms on absolute deadlines, lateness (ns) as its payload.
   Usage: cadence FD, a connected datagram socket; runs until killed. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

int main(int argc, char **argv)
{
	struct { uint32_t id; uint8_t length, pad[3]; int64_t late_ns; } frame = { 0, 8, {0}, 0 };
	struct timespec next, now;
	int fd = argc > 1 ? atoi(argv[1]) : 1;

	clock_gettime(CLOCK_MONOTONIC, &next);
	for (;;) {
		next.tv_nsec += 50000000;
		if (next.tv_nsec >= 1000000000) {
			next.tv_nsec -= 1000000000;
			next.tv_sec++;
		}
		clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
		clock_gettime(CLOCK_MONOTONIC, &now);
		frame.late_ns = (now.tv_sec - next.tv_sec) * 1000000000LL + now.tv_nsec - next.tv_nsec;
		if (send(fd, &frame, sizeof frame, MSG_DONTWAIT) < 0)
			return 1;
	}
}
