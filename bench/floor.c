/* The least that keeps a frame table and two commands every 50 ms, as a yardstick.
   Usage: floor tick|frame INTERFACE|FD
   tick: one wake-up a tick, which reads all that waits; frame: one wake-up for each frame.
   On SIGTERM it prints when each tick was due and how late it was, in ns of CLOCK_MONOTONIC. */
#define _GNU_SOURCE
#include <ctype.h>
#include <net/if.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <linux/can.h>

#define PERIOD_NS 50000000LL
#define TICKS_AT_MOST 100000
#define MANY_FRAMES 139 /* in one reading: then the next period is read in its middle, too */

static struct can_frame table[4096];
static int64_t deadlines[TICKS_AT_MOST], lateness[TICKS_AT_MOST];
static volatile sig_atomic_t ended;

static void end(int number)
{
	(void)number;
	ended = 1;
}

static int64_t now_ns(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static void sleep_until(int64_t at_ns)
{
	struct timespec at = { at_ns / 1000000000LL, at_ns % 1000000000LL };

	clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
}

static int receive(int fd)
{
	struct can_frame frame;

	if (recv(fd, &frame, sizeof frame, MSG_DONTWAIT) != sizeof frame)
		return 0;
	table[(frame.can_id >> 8 ^ frame.can_id) % 4096] = frame;
	return 1;
}

static int drain(int fd)
{
	int count = 0;

	while (receive(fd))
		count++;
	return count;
}

static void receive_until(int fd, int64_t at_ns)
{
	struct pollfd waiting = { fd, POLLIN, 0 };
	int64_t left_ns;

	while (!ended && (left_ns = at_ns - now_ns()) > 0) {
		struct timespec left = { 0, left_ns };

		if (ppoll(&waiting, 1, &left, NULL) > 0)
			receive(fd);
	}
}

static int can_socket(const char *interface)
{
	struct sockaddr_can address = { .can_family = AF_CAN };
	int fd = socket(AF_CAN, SOCK_RAW, CAN_RAW);

	address.can_ifindex = if_nametoindex(interface);
	if (fd < 0 || bind(fd, (struct sockaddr *)&address, sizeof address) < 0) {
		perror(interface);
		exit(1);
	}
	return fd;
}

int main(int argc, char **argv)
{
	static const canid_t ids[] = { 0x0008A7D0 | CAN_EFF_FLAG, 0x0008A8D0 | CAN_EFF_FLAG };
	struct can_frame command = { .can_dlc = 8, .data = { 0x0c, 0, 0, 0, 0xe0, 0x2e, 0, 0 } };
	struct sigaction action = { .sa_handler = end };
	int by_tick, fd, ticks = 0, many = 0;
	int64_t next;

	if (argc != 3)
		return 2;
	by_tick = !strcmp(argv[1], "tick");
	fd = isdigit((unsigned char)argv[2][0]) ? atoi(argv[2]) : can_socket(argv[2]);
	sigaction(SIGTERM, &action, NULL);
	for (next = now_ns() + PERIOD_NS; !ended; next += PERIOD_NS) {
		if (by_tick && many) {
			sleep_until(next - PERIOD_NS / 2);
			drain(fd);
		}
		if (by_tick)
			sleep_until(next);
		else
			receive_until(fd, next);
		if (ended)
			break;
		if (ticks < TICKS_AT_MOST) {
			deadlines[ticks] = next;
			lateness[ticks++] = now_ns() - next;
		}
		if (by_tick)
			many = drain(fd) > MANY_FRAMES / (many + 1);
		for (int i = 0; i < 2; i++) {
			command.can_id = ids[i];
			send(fd, &command, sizeof command, MSG_DONTWAIT);
		}
	}
	printf("{\"ticks\": [");
	for (int i = 0; i < ticks; i++)
		printf("%s[%lld, %lld]", i ? ", " : "", (long long)deadlines[i], (long long)lateness[i]);
	printf("]}\n");
	return 0;
}
