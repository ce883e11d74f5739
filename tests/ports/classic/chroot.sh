#!/bin/sh
# Gazebo Classic 11 in a chroot of Debian 11, for the tests with the real server: 1.3 GB, about five minutes. As root.
set -eu
root=${1:-/var/tmp/ullage-gazebo-classic}
[ -x "$root/usr/bin/gzserver" ] && { echo "$root is there already"; exit 0; }
debootstrap --variant=minbase --include=ca-certificates bullseye "$root"
chroot "$root" apt-get update -q
DEBIAN_FRONTEND=noninteractive chroot "$root" apt-get install -y -q --no-install-recommends gazebo gazebo-plugin-base
du -sh "$root"
