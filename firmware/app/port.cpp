#include "app/port.hpp"

#include <sys/stat.h>

#include <cstdio>
#include <fstream>
#include <iterator>

#include "app/serial_endpoint.hpp"
#include "app/udp_endpoint.hpp"

namespace noctule {

std::unique_ptr<Endpoint> open_endpoint(const std::string& url, std::string& error) {
    std::unique_ptr<Endpoint> endpoint;
    if (url.rfind("serial:", 0) == 0) { endpoint = std::make_unique<SerialEndpoint>(); } else { endpoint = std::make_unique<UdpEndpoint>(); }
    if (endpoint->open(url)) { return endpoint; }
    error = endpoint->error();
    return nullptr;
}

bool load_signing_key(const std::string& path, std::array<std::uint8_t, 32>& key, std::string& error) {
    std::ifstream file(path, std::ios::binary);
    struct stat status {};
    if (!file || ::stat(path.c_str(), &status) != 0) {
        error = path + ": cannot be read";
        return false;
    }
    if ((status.st_mode & (S_IRWXG | S_IRWXO)) != 0) {
        error = path + ": others may read this key; run: chmod 600 " + path;
        return false;
    }
    std::string text{std::istreambuf_iterator<char>(file), {}};
    if (text.size() == key.size()) {
        std::copy(text.begin(), text.end(), key.begin());
        return true;
    }
    while (!text.empty() && (text.back() == '\n' || text.back() == '\r' || text.back() == ' ')) { text.pop_back(); }
    for (std::size_t i = 0; text.size() == 2 * key.size() && i < key.size(); ++i) {
        unsigned byte = 0;
        if (text.find_first_not_of("0123456789abcdefABCDEF") != std::string::npos || std::sscanf(text.c_str() + 2 * i, "%2x", &byte) != 1) { text.clear(); }
        key[i] = static_cast<std::uint8_t>(byte);
    }
    if (text.size() == 2 * key.size()) { return true; }
    error = path + ": is no key: 32 bytes, or 64 hexadecimal digits";
    return false;
}

}  // namespace noctule
